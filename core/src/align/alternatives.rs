//! Other poses that explain a batch: few, in an array, for an answer allocates nothing.

use std::ops::Deref;

use crate::pose::Pose2;

/// Other poses as corrections of the prior with their score relative to the answer's, best first;
/// at most [`Alternatives::MOST`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Alternatives {
    all: [(Pose2, f64); Self::MOST],
    count: usize,
}

impl Alternatives {
    /// As many as there is room for.
    pub const MOST: usize = 8;

    /// Adds one that is worse than those before; left out when there are enough.
    pub fn push(&mut self, correction: Pose2, relative_score: f64) {
        if let Some(free) = self.all.get_mut(self.count) {
            *free = (correction, relative_score);
            self.count += 1;
        }
    }
}

impl Deref for Alternatives {
    type Target = [(Pose2, f64)];

    fn deref(&self) -> &Self::Target {
        &self.all[..self.count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_stay() {
        let mut others = Alternatives::default();
        assert!(others.is_empty());
        for i in 0..20 {
            others.push(Pose2::IDENTITY, f64::from(i));
        }
        assert_eq!(others.len(), Alternatives::MOST);
        assert!(others.iter().zip(0_u32..).all(|((_, score), i)| (score - f64::from(i)).abs() < 1e-12));
    }
}

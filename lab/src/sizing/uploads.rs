//! Uploads on their way: in vehicles' spools, in the journal, in the map.

use serde::Serialize;

/// Uploads that wait to be folded, at most (`mapping.max_unfolded`).
const MOST_UNFOLDED: f64 = 10_000.0;

/// Where the uploads are.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Uploads {
    pub made: f64,
    /// In vehicles' spools, after they were refused.
    pub spooled: f64,
    /// Acknowledged, and not in the map yet.
    pub unfolded: f64,
    pub folded: f64,
    /// Answers that refused, or asked to come again.
    pub refusals: f64,
    pub most_spooled: f64,
    pub most_unfolded: f64,
}

impl Uploads {
    /// A minute in which vehicles make uploads, and each replica folds so many. What was refused is sent again with the next
    /// minute's. Returns how many were acknowledged.
    pub fn minute(&mut self, made: f64, folds: f64, away: bool) -> f64 {
        self.made += made;
        let offered = self.spooled + made;
        let room = if away { 0.0 } else { (MOST_UNFOLDED - self.unfolded + folds).max(0.0) };
        let acknowledged = offered.min(room);
        self.spooled = offered - acknowledged;
        self.refusals += self.spooled;
        let folded = folds.min(self.unfolded + acknowledged);
        self.unfolded += acknowledged - folded;
        self.folded += folded;
        self.most_spooled = self.most_spooled.max(self.spooled);
        self.most_unfolded = self.most_unfolded.max(self.unfolded);
        acknowledged
    }

    /// What is nowhere.
    pub fn lost(&self) -> f64 {
        self.made - self.spooled - self.unfolded - self.folded
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: uploads that an outage or a full journal loses or doubles.
    #[test]
    fn every_upload_is_somewhere() {
        let mut uploads = Uploads::default();
        for minute in 0..2000 {
            let made = if (300..900).contains(&minute) { 9_000.0 } else { 500.0 };
            uploads.minute(made, 3_700.0, minute % 100 < 3);
            assert!(uploads.lost().abs() < 1e-6 * uploads.made, "{minute}: {uploads:?}");
            assert!(uploads.unfolded <= MOST_UNFOLDED + 1e-6);
        }
        assert!(uploads.most_spooled > 1e6 && uploads.spooled < 2000.0, "{uploads:?}");
    }
}

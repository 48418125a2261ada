//! The receiver operating characteristic: does a score distinguish wrong answers from right ones?

/// Detections and false alarms at all thresholds.
#[derive(Debug, Clone, PartialEq)]
pub struct Roc {
    /// (fraction of the right answers that are refused, fraction of the wrong ones that are), from the
    /// highest threshold to the lowest.
    pub points: Vec<(f64, f64)>,
    /// Probability that a wrong answer scores above a right one: 0.5 when the score says nothing.
    pub area: f64,
    /// Number of wrong answers.
    pub wrong: usize,
    /// Number of right answers.
    pub right: usize,
}

/// The characteristic of (score, wrong) pairs; `None` without right or without wrong answers.
pub fn roc(sample: impl IntoIterator<Item = (f64, bool)>) -> Option<Roc> {
    let mut sorted: Vec<_> = sample.into_iter().collect();
    sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
    let wrong = sorted.iter().filter(|(_, wrong)| *wrong).count();
    let right = sorted.len() - wrong;
    if wrong == 0 || right == 0 {
        return None;
    }
    let mut points = vec![(0.0, 0.0)];
    let (mut refused, mut area) = ([0_usize; 2], 0.0);
    // All equal scores pass a threshold together.
    for equal in sorted.chunk_by(|a, b| a.0.total_cmp(&b.0).is_eq()) {
        for (_, wrong) in equal {
            refused[usize::from(*wrong)] += 1;
        }
        let point = (refused[0] as f64 / right as f64, refused[1] as f64 / wrong as f64);
        let before = points[points.len() - 1];
        area += 0.5 * (point.0 - before.0) * (point.1 + before.1);
        points.push(point);
    }
    Some(Roc { points, area, wrong, right })
}

impl Roc {
    /// Fraction of the wrong answers that are refused when at most this fraction of the right ones is.
    pub fn detected_at(&self, false_alarms: f64) -> f64 {
        self.points.iter().take_while(|p| p.0 <= false_alarms).map(|p| p.1).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_the_chance_that_wrong_outranks_right() {
        let sample = [(0.9, true), (0.8, false), (0.7, true), (0.3, false), (0.2, false), (0.2, true)];
        let found = roc(sample).unwrap();
        // 3 x 3 pairs: 0.9 beats all three, 0.7 beats two, 0.2 ties with one.
        assert!((found.area - 5.5 / 9.0).abs() < 1e-12, "{}", found.area);
        assert_eq!((found.wrong, found.right, found.points[found.points.len() - 1]), (3, 3, (1.0, 1.0)));
        assert!((found.detected_at(0.0) - 1.0 / 3.0).abs() < 1e-12);
        assert!((found.detected_at(0.5) - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(roc([(0.5, false)]), None);
    }
}

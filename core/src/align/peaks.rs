//! The highest distinct maxima of the correlation.

use super::{Correlation, Search};
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// A cell of the correlation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// The hypothesis: metres east and north, radians.
    pub correction: Pose2,
    /// Its correlation.
    pub value: f32,
    /// True when it lies on the edge of the search.
    pub at_edge: bool,
}

impl Correlation {
    /// The hypothesis of a value's index.
    #[must_use]
    pub fn hypothesis(&self, index: usize) -> Pose2 {
        let [turn, row, column] = self.place(index);
        let shift = |i: usize| (i as f64 - self.lag as f64) * CELL_M;
        Pose2::new(shift(column), shift(row), (turn as f64 - self.turns as f64) * self.yaw_step_rad)
    }

    /// The global maximum (fastGlobalAlign l. 13); of equal values the first.
    #[must_use]
    pub fn argmax(&self) -> usize {
        let best =
            self.values.iter().enumerate().reduce(|a, b| if b.1.total_cmp(a.1).is_gt() { b } else { a });
        best.map_or(0, |(index, _)| index)
    }

    fn place(&self, index: usize) -> [usize; 3] {
        let width = 2 * self.lag + 1;
        [index / (width * width), index / width % width, index % width]
    }

    fn peak(&self, index: usize) -> Peak {
        let [_, row, column] = self.place(index);
        let edge = |i: usize| self.lag > 0 && (i == 0 || i == 2 * self.lag);
        Peak {
            correction: self.hypothesis(index),
            value: self.values[index],
            at_edge: edge(row) || edge(column),
        }
    }
}

/// The highest maxima, best first, no two within the separation; at most `search.peaks`.
#[must_use]
pub fn highest(correlation: &Correlation, search: &Search) -> Vec<Peak> {
    let mut peaks: Vec<Peak> = Vec::new();
    let mut best = best_by_column(correlation);
    while peaks.len() < search.peaks {
        let Some(index) = best.iter().copied().flatten().reduce(|a, b| higher(correlation, a, b)) else {
            break;
        };
        let peak = correlation.peak(index);
        for (column, slot) in best.iter_mut().enumerate() {
            let near = correlation.hypothesis(column).distance_m(&peak.correction) < search.separation_m;
            if near {
                *slot = None;
            }
        }
        peaks.push(peak);
    }
    peaks
}

/// For every shift the index of its best heading; as if looking down on the volume.
fn best_by_column(correlation: &Correlation) -> Vec<Option<usize>> {
    let plane = (2 * correlation.lag + 1).pow(2);
    let mut best: Vec<Option<usize>> = (0..plane).map(Some).collect();
    for index in plane..correlation.values.len() {
        let slot = &mut best[index % plane];
        *slot = slot.map(|so_far| higher(correlation, so_far, index));
    }
    best
}

fn higher(correlation: &Correlation, a: usize, b: usize) -> usize {
    if correlation.values[b] > correlation.values[a] { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_are_distinct_and_in_order() {
        let (lag, turns) = (30, 1);
        let width = 2 * lag + 1;
        let mut values = vec![0.0; 3 * width * width];
        let index = |turn: usize, row: usize, column: usize| (turn * width + row) * width + column;
        values[index(1, 30, 30)] = 9.0;
        values[index(1, 30, 35)] = 8.0;
        values[index(2, 0, 10)] = 7.0;
        let correlation = Correlation { lag, turns, yaw_step_rad: 0.02, values };
        let search = Search { peaks: 2, ..Search::default() };
        let found = highest(&correlation, &search);
        assert_eq!(correlation.argmax(), index(1, 30, 30));
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].correction, Pose2::new(0.0, 0.0, 0.0));
        assert!((found[1].correction.x_m + 2.0).abs() < 1e-9 && (found[1].correction.y_m + 3.0).abs() < 1e-9);
        assert!((found[1].correction.yaw_rad - 0.02).abs() < 1e-12 && found[1].at_edge && !found[0].at_edge);
    }
}

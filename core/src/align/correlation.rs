//! The correlation of map and batch for every hypothesis.

use super::{Prior, Search};
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// The hypotheses to be searched: shifts of cells and turns of steps around the prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Half width of the shifts, cells.
    pub lag: usize,
    /// Half width of the headings, steps.
    pub turns: usize,
    /// Step of the headings, radians.
    pub yaw_step_rad: f64,
}

impl Lattice {
    /// The hypotheses within the search's sigmas of a prior.
    #[must_use]
    pub fn of(prior: &Prior, search: &Search) -> Self {
        let steps = |sigma: f64, step: f64| (search.sigmas * sigma / step).ceil() as usize;
        Self {
            // fastGlobalAlign l. 6
            lag: steps(prior.sigma_position_m, CELL_M),
            // l. 7
            turns: steps(prior.sigma_yaw_rad, search.yaw_step_rad),
            yaw_step_rad: search.yaw_step_rad,
        }
    }

    /// Shifts along one axis.
    #[must_use]
    pub fn width(&self) -> usize {
        2 * self.lag + 1
    }

    /// Shifts for one heading.
    #[must_use]
    pub fn plane(&self) -> usize {
        self.width() * self.width()
    }

    /// Headings.
    #[must_use]
    pub fn headings(&self) -> usize {
        2 * self.turns + 1
    }

    /// The turn of a heading, radians.
    #[must_use]
    pub fn turn_rad(&self, heading: usize) -> f64 {
        (heading as f64 - self.turns as f64) * self.yaw_step_rad
    }

    /// The hypothesis of an index: by heading from -turns to turns, then by row from -lag to lag,
    /// then by column.
    #[must_use]
    pub fn hypothesis(&self, index: usize) -> Pose2 {
        let shift = |i: usize| (i as f64 - self.lag as f64) * CELL_M;
        let (row, column) = (index % self.plane() / self.width(), index % self.width());
        Pose2::new(shift(column), shift(row), self.turn_rad(index / self.plane()))
    }

    /// Half widths: metres and radians.
    #[must_use]
    pub fn half_widths(&self) -> (f64, f64) {
        (self.lag as f64 * CELL_M, self.turns as f64 * self.yaw_step_rad)
    }

    /// True when a refined correction lies on the edge of the search or beyond.
    #[must_use]
    pub fn is_left_by(&self, correction: &Pose2) -> bool {
        let (half_m, half_yaw_rad) = self.half_widths();
        let shift = correction.x_m.abs().max(correction.y_m.abs());
        shift > half_m - CELL_M || correction.yaw_rad.abs() > half_yaw_rad
    }

    /// True when an index's shift lies on the edge of the search.
    #[must_use]
    pub fn is_at_edge(&self, index: usize) -> bool {
        let edge = |i: usize| self.lag > 0 && (i == 0 || i == 2 * self.lag);
        edge(index % self.plane() / self.width()) || edge(index % self.width())
    }
}

/// The correlation for every hypothesis of a lattice.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlation {
    /// The hypotheses.
    pub lattice: Lattice,
    /// `R[i, dy, dx]`, in the lattice's order.
    pub values: Vec<f32>,
}

impl Correlation {
    /// The global maximum (fastGlobalAlign l. 13); of equal values the first.
    #[must_use]
    pub fn argmax(&self) -> usize {
        let best =
            self.values.iter().enumerate().reduce(|a, b| if b.1.total_cmp(a.1).is_gt() { b } else { a });
        best.map_or(0, |(index, _)| index)
    }

    /// The highest maxima, best first, no two within `separation_m`; at most `most`. For each shift
    /// only the best heading counts, as if looking down on the volume.
    #[must_use]
    pub fn highest(&self, most: usize, separation_m: f64) -> Vec<usize> {
        let plane = self.lattice.plane();
        let higher = |a: usize, b: usize| if self.values[b] > self.values[a] { b } else { a };
        let mut best: Vec<Option<usize>> = (0..plane).map(Some).collect();
        for index in plane..self.values.len() {
            let slot = &mut best[index % plane];
            *slot = slot.map(|so_far| higher(so_far, index));
        }
        let mut maxima = Vec::new();
        while maxima.len() < most {
            let Some(index) = best.iter().copied().flatten().reduce(higher) else { break };
            let maximum = self.lattice.hypothesis(index);
            for (shift, slot) in best.iter_mut().enumerate() {
                if self.lattice.hypothesis(shift).distance_m(&maximum) < separation_m {
                    *slot = None;
                }
            }
            maxima.push(index);
        }
        maxima
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_are_distinct_and_in_order() {
        let lattice = Lattice { lag: 30, turns: 1, yaw_step_rad: 0.02 };
        let mut values = vec![0.0; lattice.headings() * lattice.plane()];
        let index = |turn: usize, row: usize, column: usize| (turn * 61 + row) * 61 + column;
        values[index(1, 30, 30)] = 9.0;
        values[index(1, 30, 35)] = 8.0;
        values[index(2, 0, 10)] = 7.0;
        let correlation = Correlation { lattice, values };
        let found = correlation.highest(2, 1.0);
        assert_eq!(correlation.argmax(), index(1, 30, 30));
        assert_eq!(found, [index(1, 30, 30), index(2, 0, 10)]);
        let [first, second] = [0, 1].map(|i: usize| lattice.hypothesis(found[i]));
        assert_eq!(first, Pose2::new(0.0, 0.0, 0.0));
        assert!((second.x_m + 2.0).abs() < 1e-9 && (second.y_m + 3.0).abs() < 1e-9);
        assert!((second.yaw_rad - 0.02).abs() < 1e-12);
        assert!(lattice.is_at_edge(found[1]) && !lattice.is_at_edge(found[0]));
    }

    /// Catches an edge that is taken for inside: the last cell of the search may be the slope of a maximum beyond.
    #[test]
    fn a_search_is_left_by_its_last_cell_and_beyond_its_last_heading() {
        let lattice = Lattice { lag: 30, turns: 1, yaw_step_rad: 0.02 };
        let left = |x_m, y_m, yaw_rad| lattice.is_left_by(&Pose2::new(x_m, y_m, yaw_rad));
        assert!(!left(2.8, -2.8, 0.015));
        assert!(left(2.95, 0.0, 0.0) && left(0.0, -2.95, 0.0) && left(0.0, 0.0, 0.021));
    }
}

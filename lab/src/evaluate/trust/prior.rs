//! Where priors lie. All of them claim the paper's sigmas.

use std::f64::consts::TAU;

use echofix_core::align::Prior;
use echofix_core::pose::Pose2;
use echofix_harness::prior::PriorSigma;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How a prior lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PriorLie {
    /// It does not: it is drawn from its sigmas.
    Honest,
    /// So many sigmas off along the street; the heading is right.
    Along(f64),
    /// So many sigmas off across the street; the heading is right.
    Across(f64),
    /// Metres off in any direction, from, to; the heading is right.
    Metres(f64, f64),
    /// On another place of the map, 60 to 200 m away.
    WrongStreet,
}

/// Nearest and farthest wrong street, metres.
const WRONG_STREET_M: (f64, f64) = (60.0, 200.0);

impl PriorLie {
    /// A prior for a true pose, map metres; `None` where there is no place for this lie. `known` are poses in mapped
    /// streets.
    pub fn drawn(self, truth: &Pose2, known: &[Pose2], scale: f64, seed: u64) -> Option<Prior> {
        let PriorSigma { position_m: sigma_position_m, yaw_rad: sigma_yaw_rad } = PriorSigma::PAPER;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let moved = |along: f64, across: f64| truth.compose(&Pose2::new(along, across, 0.0));
        let pose = match self {
            Self::Honest => PriorSigma::PAPER.drawn_around(truth, &mut rng),
            Self::Along(k) => moved(sign * k * sigma_position_m, 0.0),
            Self::Across(k) => moved(0.0, sign * k * sigma_position_m),
            Self::Metres(least, most) => {
                let (way_m, angle_rad) = (rng.random_range(least..=most), rng.random_range(0.0..TAU));
                moved(way_m * angle_rad.cos(), way_m * angle_rad.sin())
            }
            Self::WrongStreet => {
                let far =
                    |pose: &&Pose2| (WRONG_STREET_M.0..WRONG_STREET_M.1).contains(&pose.distance_m(truth));
                let far: Vec<_> = known.iter().filter(far).collect();
                let there = far.get(rng.random_range(0..far.len().max(1)))?;
                PriorSigma::PAPER.drawn_around(there, &mut rng)
            }
        };
        Some(Prior { pose, sigma_position_m, sigma_yaw_rad, scale })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn priors_lie_as_far_as_they_should() {
        let truth = Pose2::new(100.0, 50.0, 0.4);
        let known = [truth, truth.compose(&Pose2::new(0.0, 100.0, 0.0))];
        for seed in 0..50 {
            let off = |lie: PriorLie| truth.between(&lie.drawn(&truth, &known, 1.0, seed).unwrap().pose);
            assert!((off(PriorLie::Along(4.0)).x_m.abs() - 8.0).abs() < 1e-9);
            assert!((off(PriorLie::Across(4.0)).y_m.abs() - 8.0).abs() < 1e-9);
            let far = off(PriorLie::Metres(12.0, 30.0));
            assert!((12.0..=30.0).contains(&far.x_m.hypot(far.y_m)) && far.yaw_rad.abs() < 1e-9);
            assert!((off(PriorLie::WrongStreet).y_m - 100.0).abs() < 12.0);
        }
        assert_eq!(PriorLie::WrongStreet.drawn(&truth, &known[..1], 1.0, 1), None);
    }
}

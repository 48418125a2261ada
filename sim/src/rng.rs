//! Independent random streams: one per (seed, purpose, two indices), so that adding one thing
//! to the city does not shift the others.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Poisson, StandardNormal};

/// What a stream of random numbers is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Where the nodes of the street network lie and how wide the streets are.
    Streets,
    /// Building fronts, by frontage.
    Fronts,
    /// Lamps, signs, trees and kerb clutter, by street and side.
    Furniture,
    /// Where parking slots lie, by street and side.
    Slots,
    /// Which car stands in a slot, by day and slot.
    Parked,
    /// Moving vehicles, by day.
    Traffic,
    /// The nodes a route visits.
    Tour,
    /// Speeds and stops of a drive.
    Motion,
    /// Detections of one radar, by day and sensor.
    Radar,
    /// Errors of the reference pose, by day.
    Reference,
    /// Errors of the odometry, by day.
    Odometry,
    /// What a family draws for a world.
    Family,
}

/// The stream of a purpose and up to two indices.
#[must_use]
pub fn stream(seed: u64, purpose: Purpose, first: u64, second: u64) -> ChaCha8Rng {
    let mut key = [0_u8; 32];
    for (bytes, word) in key.chunks_exact_mut(8).zip([seed, purpose as u64, first, second]) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// A draw of mean 0 and the given standard deviation.
pub fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let unit: f64 = rng.sample(StandardNormal);
    sigma * unit
}

/// A draw from `low..=high`, which may be equal.
pub fn uniform(rng: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// A count of the given mean.
pub fn poisson(rng: &mut ChaCha8Rng, mean: f64) -> usize {
    Poisson::new(mean).map_or(0, |counts| rng.sample(counts) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_repeat_and_differ() {
        let draw = |purpose, a, b| stream(7, purpose, a, b).random::<u64>();
        assert_eq!(draw(Purpose::Fronts, 1, 2), draw(Purpose::Fronts, 1, 2));
        assert_ne!(draw(Purpose::Fronts, 1, 2), draw(Purpose::Fronts, 2, 1));
        assert_ne!(draw(Purpose::Fronts, 1, 2), draw(Purpose::Radar, 1, 2));
    }

    #[test]
    fn a_mean_of_zero_counts_nothing() {
        let mut rng = stream(1, Purpose::Radar, 0, 0);
        assert_eq!(poisson(&mut rng, 0.0), 0);
        let sum: usize = (0..1000).map(|_| poisson(&mut rng, 3.0)).sum();
        assert!((2700..3300).contains(&sum), "{sum}");
    }
}

//! How many of the vehicles are on the road, over a day.

/// Minutes of a day.
pub(super) const MINUTES: usize = 1440;

/// Of the vehicles at the busiest hour, the share at each full hour, local time. Assumed: two rush hours and a quiet night.
const SHARE: [f64; 24] = [
    0.10, 0.07, 0.05, 0.05, 0.08, 0.20, 0.50, 0.90, 1.00, 0.75, 0.62, 0.62, 0.65, 0.66, 0.68, 0.78, 0.92,
    1.00, 0.88, 0.65, 0.45, 0.35, 0.25, 0.15,
];

/// The share at a time, hours; between full hours a line.
pub(super) fn share_at(hours: f64) -> f64 {
    let hours = hours.rem_euclid(24.0);
    let (at, part) = (hours as usize % 24, hours.fract());
    SHARE[at] * (1.0 - part) + SHARE[(at + 1) % 24] * part
}

/// The share on an average minute.
pub(super) fn mean_share() -> f64 {
    SHARE.iter().sum::<f64>() / 24.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_is_a_day() {
        assert!((share_at(8.0) - 1.0).abs() < 1e-12 && (share_at(32.0) - 1.0).abs() < 1e-12);
        assert!((share_at(-0.5) - 0.125).abs() < 1e-12);
        let mean: f64 =
            (0..MINUTES).map(|minute| share_at(minute as f64 / 60.0)).sum::<f64>() / MINUTES as f64;
        assert!((mean - mean_share()).abs() < 1e-9);
    }
}

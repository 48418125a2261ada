//! Times and days: UTC, counted from the Unix epoch.

/// Microseconds of a second.
pub const SECOND_US: i64 = 1_000_000;
/// Microseconds of a day.
pub const DAY_US: i64 = 86_400 * SECOND_US;

/// The UTC day of a time in microseconds since the Unix epoch. Days are counted in 16 bits, from 1970 to 2149; times before
/// and after lie on the first and the last of them.
#[must_use]
pub fn day_of(time_us: i64) -> u16 {
    time_us.div_euclid(DAY_US).clamp(0, i64::from(u16::MAX)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_begins_at_midnight_and_times_beyond_lie_on_the_first_and_the_last() {
        assert_eq!([-1, 0, DAY_US - 1, DAY_US].map(day_of), [0, 0, 0, 1]);
        assert_eq!(day_of(20_000 * DAY_US + 12 * 3600 * SECOND_US), 20_000);
        assert_eq!([65_536 * DAY_US, i64::MAX, i64::MIN].map(day_of), [u16::MAX, u16::MAX, 0]);
    }
}

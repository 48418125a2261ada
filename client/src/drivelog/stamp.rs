//! Times of a log in other units than microseconds.

/// The unit of a column of times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum TimeUnit {
    Seconds,
    Milliseconds,
    #[default]
    Microseconds,
    Nanoseconds,
}

/// From 2000 to 2100 in seconds since the Unix epoch: a time in the wrong unit lies far outside.
const PLAUSIBLE_S: std::ops::Range<f64> = 946_684_800.0..4_102_444_800.0;
/// Measurements of one drive come closer to each other than this, seconds.
const LONGEST_STEP_S: f64 = 600.0;

impl TimeUnit {
    const ALL: [Self; 4] = [Self::Microseconds, Self::Nanoseconds, Self::Milliseconds, Self::Seconds];

    /// Units in a second.
    fn per_second(self) -> f64 {
        match self {
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e3,
            Self::Microseconds => 1e6,
            Self::Nanoseconds => 1e9,
        }
    }

    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        }
    }

    /// The unit in which most of the times are dates of this century, and their steps those of a drive. Microseconds where none
    /// is: a log may count from its own beginning.
    pub(super) fn of(times: &[f64]) -> Self {
        let mut steps: Vec<f64> =
            times.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|s| *s > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        let step = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let fits = |unit: &Self| {
            let dates =
                times.iter().filter(|time| PLAUSIBLE_S.contains(&(**time / unit.per_second()))).count();
            2 * dates > times.len() && step / unit.per_second() < LONGEST_STEP_S
        };
        Self::ALL.into_iter().find(fits).unwrap_or_default()
    }

    /// Microseconds of a whole number of units; `None` beyond what they can hold.
    pub(super) fn whole(self, time: i64) -> Option<i64> {
        match self {
            Self::Seconds => time.checked_mul(1_000_000),
            Self::Milliseconds => time.checked_mul(1000),
            Self::Microseconds => Some(time),
            Self::Nanoseconds => Some(time.div_euclid(1000)),
        }
    }

    /// Microseconds of a number of units.
    pub(super) fn fraction(self, time: f64) -> Option<i64> {
        let micros = time * (1e6 / self.per_second());
        // Beyond this a double no longer holds a microsecond.
        (micros.abs() < 9e15).then_some(micros.round() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a unit that is taken for another, above all a log that counts microseconds from its own beginning.
    #[test]
    fn units_are_told_from_dates_and_steps() {
        let drive = |start: f64, step: f64| (0..50).map(|i| start + step * f64::from(i)).collect::<Vec<_>>();
        for (unit, scale) in [
            (TimeUnit::Seconds, 1.0),
            (TimeUnit::Milliseconds, 1e3),
            (TimeUnit::Microseconds, 1e6),
            (TimeUnit::Nanoseconds, 1e9),
        ] {
            let mut times = drive(1.7e9 * scale, 0.05 * scale);
            assert_eq!(TimeUnit::of(&times), unit);
            times[0] = 0.0;
            assert_eq!(TimeUnit::of(&times), unit, "one bad stamp decides");
            assert_eq!(unit.fraction(1.7e9 * scale), Some(1_700_000_000_000_000));
            assert_eq!(unit.whole((1.7e9 * scale) as i64), Some(1_700_000_000_000_000));
        }
        for start in [0.0, 1e6, 1.7e9, 3e9] {
            assert_eq!(TimeUnit::of(&drive(start, 50_000.0)), TimeUnit::Microseconds, "{start}");
        }
        assert_eq!(TimeUnit::of(&[]), TimeUnit::Microseconds);
    }
}

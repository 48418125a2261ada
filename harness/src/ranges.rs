//! Arguments that are numbers: each within what makes sense, and told so otherwise.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Reads a number as an argument, which must lie within a range; none that is no number does.
pub fn within<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync
where
    T: FromStr<Err: Display> + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let number: T = text.parse().map_err(|error: T::Err| error.to_string())?;
        let (least, most) = (range.start(), range.end());
        if range.contains(&number) { Ok(number) } else { Err(format!("must lie within {least} and {most}")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an argument that hangs the command, or lets it compute nothing for hours.
    #[test]
    fn what_is_no_number_or_makes_no_sense_is_refused() {
        let metres = within(0.5..=100.0);
        assert!((metres("3.5").unwrap() - 3.5_f64).abs() < 1e-12);
        for text in ["nan", "inf", "-1", "0", "1e9", "", "a"] {
            assert!(metres(text).is_err(), "{text}");
        }
        let at_once = within(1..=64_usize);
        assert_eq!(at_once("64"), Ok(64));
        assert_eq!(at_once("0").unwrap_err(), "must lie within 1 and 64");
        assert!(at_once("65").is_err() && at_once("-1").is_err() && at_once("1.5").is_err());
    }
}

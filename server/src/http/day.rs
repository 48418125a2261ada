//! Days of the map as calendar dates.

/// The ISO date of a UTC day counted from the Unix epoch.
pub fn iso_date(day: u16) -> String {
    // Howard Hinnant, "chrono-Compatible Low-Level Date Algorithms", civil_from_days; years begin in March.
    let days = u32::from(day) + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day_of_month = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = era * 400 + year_of_era + u32::from(month <= 2);
    format!("{year:04}-{month:02}-{day_of_month:02}")
}

/// The UTC day, counted from the Unix epoch, of an ISO date; `None` when there is no such day.
pub fn parse_date(date: &str) -> Option<u16> {
    // Dates of four-digit years sort as their days do.
    let (mut low, mut high) = (0_u32, u32::from(u16::MAX) + 1);
    while low < high {
        let middle = u32::midpoint(low, high);
        if iso_date(middle as u16).as_str() < date { low = middle + 1 } else { high = middle }
    }
    u16::try_from(low).ok().filter(|day| iso_date(*day) == date)
}

#[cfg(test)]
mod tests {
    use super::{iso_date, parse_date};

    #[test]
    fn days_are_dates() {
        assert_eq!(iso_date(0), "1970-01-01");
        assert_eq!(iso_date(11_016), "2000-02-29");
        assert_eq!(iso_date(11_017), "2000-03-01");
        assert_eq!(iso_date(20_088), "2024-12-31");
        assert_eq!(iso_date(u16::MAX), "2149-06-06");
    }

    #[test]
    fn dates_are_days() {
        for day in (0..=u16::MAX).step_by(7) {
            assert_eq!(parse_date(&iso_date(day)), Some(day));
        }
        for date in ["", "2026-02-30", "2026-2-3", "1969-12-31", "2149-06-07", "9999-01-01", "x"] {
            assert_eq!(parse_date(date), None, "{date}");
        }
    }
}

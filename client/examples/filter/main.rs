//! What the filter is worth: seeded drives of ten minutes, once with the last fix carried on by
//! odometry and once with the filter.
//!
//! ```text
//! cargo run -p echofix-client --example filter [-- FIRST_SEED LAST_SEED]
//! ```

mod compare;
mod drive;

use std::error::Error;
use std::io::Write;

use compare::Comparison;
use echofix_client::filter::FilterConfig;

fn main() -> Result<(), Box<dyn Error>> {
    let mut seeds = std::env::args().skip(1).map(|seed| seed.parse::<u64>());
    let (first, last) = (seeds.next().unwrap_or(Ok(1))?, seeds.next().unwrap_or(Ok(8))?);
    let config = FilterConfig::default();
    let drives: Result<Vec<_>, _> =
        (first..=last).map(|seed| drive::drive(seed, config.fixes.middle)?.compare(config)).collect();
    let all = Comparison::pooled(drives?);
    write!(std::io::stdout(), "drives of ten minutes, seeds {first} to {last}\n\n{}", all.table())?;
    Ok(())
}

//! Ten-minute drives with fixes that are lost, late, out of order and wrong: the filter must be
//! better than the last fix carried on by odometry, and must know how good it is.

#[path = "../../examples/filter/compare.rs"]
mod compare;
#[path = "../../examples/filter/drive.rs"]
mod drive;

use std::error::Error;

use compare::Comparison;
use echofix_client::filter::FilterConfig;

const SEEDS: std::ops::RangeInclusive<u64> = 1..=8;

/// Drives whose fixes measure this far back into their batch, with a filter that knows.
fn drives(middle: f64) -> Result<Vec<Comparison>, Box<dyn Error>> {
    let mut config = FilterConfig::default();
    config.fixes.middle = middle;
    SEEDS.map(|seed| drive::drive(seed, middle)?.compare(config)).collect()
}

fn is_better_and_knows_it(middle: f64) -> Result<(), Box<dyn Error>> {
    let drives = drives(middle)?;
    for (seed, drive) in SEEDS.zip(&drives) {
        let [raw_m, filtered_m] =
            [drive.percentile(0.95, |s| s.raw_m), drive.percentile(0.95, |s| s.filtered_m)];
        assert!(filtered_m < 0.30, "seed {seed}: {filtered_m} m\n{}", drive.table());
        assert!(filtered_m < 0.9 * raw_m, "seed {seed}: {filtered_m} m of {raw_m} m\n{}", drive.table());
        let [raw_rad, filtered_rad] =
            [drive.percentile(0.95, |s| s.raw_rad), drive.percentile(0.95, |s| s.filtered_rad)];
        assert!(filtered_rad < raw_rad, "seed {seed}: {filtered_rad} of {raw_rad}\n{}", drive.table());
        assert!(drive.samples.len() > 2900, "seed {seed}: {} samples", drive.samples.len());
        assert_eq!(drive.resets, 0, "seed {seed}: no two wrong fixes agree");
    }
    let all = Comparison::pooled(drives);
    eprintln!("fixes measure {middle} of a batch before their time\n{}", all.table());
    let nees = all.mean_nees();
    assert!((2.1..3.9).contains(&nees), "the covariance is not honest: {nees}\n{}", all.table());
    Ok(())
}

#[test]
fn fixes_of_the_middle_of_a_batch_are_fused() -> Result<(), Box<dyn Error>> {
    is_better_and_knows_it(0.5)
}

#[test]
fn fixes_of_their_own_time_are_fused() -> Result<(), Box<dyn Error>> {
    is_better_and_knows_it(0.0)
}

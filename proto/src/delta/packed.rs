//! Poses on a fine grid, as second differences.

use super::Unfit;
use crate::v1;

/// Steps of the grid a metre: one is a micrometre, far below what odometry knows.
const PER_METRE: f64 = (1_u64 << 20) as f64;
/// Steps a radian.
const PER_RADIAN: f64 = (1_u64 << 24) as f64;
/// Beyond this, steps are not exact in `f64`.
const MOST_STEPS: f64 = (1_u64 << 52) as f64;

/// A pose (metres, metres, radians) on the grid that packs into few bytes, less than a micrometre away.
#[must_use]
pub fn on_grid([x_m, y_m, yaw_rad]: [f64; 3]) -> [f64; 3] {
    // Zero has one sign there.
    let near = |value: f64, per: f64| (value * per).round() / per + 0.0;
    [near(x_m, PER_METRE), near(y_m, PER_METRE), near(yaw_rad, PER_RADIAN)]
}

/// Poses as second differences; `None` where one is not on the grid.
pub(super) fn pack(way: &v1::Odometry) -> Option<v1::PackedPoses> {
    Some(v1::PackedPoses {
        time_offset: differences(way.time_offset_us.iter().copied()),
        x: steps(&way.x_m, PER_METRE)?,
        y: steps(&way.y_m, PER_METRE)?,
        yaw: steps(&way.yaw_rad, PER_RADIAN)?,
    })
}

/// Fills the columns of poses.
pub(super) fn unpack(packed: &v1::PackedPoses, way: &mut v1::Odometry) -> Result<(), Unfit> {
    if !way.time_offset_us.is_empty() || !way.x_m.is_empty() || !way.y_m.is_empty() || !way.yaw_rad.is_empty()
    {
        return Err(Unfit { field: "packed", problem: "comes beside poses in `odometry`; send one of them" });
    }
    way.time_offset_us = sums(&packed.time_offset).collect();
    let values = |column: &[i64], per: f64| sums(column).map(|steps| steps as f64 / per).collect();
    way.x_m = values(&packed.x, PER_METRE);
    way.y_m = values(&packed.y, PER_METRE);
    way.yaw_rad = values(&packed.yaw, PER_RADIAN);
    Ok(())
}

fn steps(column: &[f64], per: f64) -> Option<Vec<i64>> {
    let exact = |value: &f64| {
        let steps = value * per;
        let whole = steps.abs() < MOST_STEPS && ((steps as i64) as f64 / per).to_bits() == value.to_bits();
        whole.then_some(steps as i64)
    };
    Some(differences(column.iter().map(exact).collect::<Option<Vec<_>>>()?.into_iter()))
}

/// Wraps around as [`sums`] does, which takes it back.
fn differences(values: impl Iterator<Item = i64>) -> Vec<i64> {
    let (mut last, mut before) = (0_i64, 0_i64);
    let difference = |value: i64| {
        let expected = last.wrapping_mul(2).wrapping_sub(before);
        (before, last) = (last, value);
        value.wrapping_sub(expected)
    };
    values.map(difference).collect()
}

fn sums(differences: &[i64]) -> impl Iterator<Item = i64> {
    let (mut last, mut before) = (0_i64, 0_i64);
    differences.iter().map(move |difference| {
        let value = last.wrapping_mul(2).wrapping_sub(before).wrapping_add(*difference);
        (before, last) = (last, value);
        value
    })
}

//! Batches as what is new of them: the vehicle makes a delta, the service applies it, both by this module.
//!
//! - [`between`]: the delta from a base to a batch, where there is one that gives the batch to the bit.
//! - [`applied`]: the batch that a delta makes of a base.
//! - [`on_grid`]: odometry's values on the grid that packs into few bytes.

mod packed;
mod scans;
#[cfg(test)]
mod tests;

use crate::v1;
pub use packed::on_grid;

/// Why a delta makes no batch of its base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unfit {
    /// The field of the delta at fault.
    pub field: &'static str,
    /// What is wrong with it.
    pub problem: &'static str,
}

const BEYOND: &str = "names rows that the base does not have";
const TIME: &str = "is too far from the base's";

/// The batch that a delta makes of its base. Its columns are as sound as those it was made of: check it as any other.
///
/// # Errors
/// Where the delta names what the base does not have.
pub fn applied(base: &v1::Batch, delta: v1::BatchDelta) -> Result<v1::Batch, Unfit> {
    let v1::BatchDelta { reference_time_us, mounts, dropped, suspected, .. } = delta;
    let shift = base.reference_time_us.checked_sub(reference_time_us);
    let shift_us = shift.ok_or(Unfit { field: "reference_time_us", problem: TIME })?;
    let kept = (delta.scans_from as usize, delta.scans_kept as usize);
    let scans = scans::applied(base.scans.as_ref(), kept, shift_us, delta.scans.unwrap_or_default())?;
    let mut way = delta.odometry.unwrap_or_default();
    if let Some(packed) = &delta.packed {
        packed::unpack(packed, &mut way)?;
    }
    let kept = (delta.poses_from as usize, delta.poses_kept as usize);
    let odometry = poses_applied(base.odometry.as_ref(), kept, shift_us, way)?;
    let mounts = if mounts.is_empty() { base.mounts.clone() } else { mounts };
    let (scans, odometry) = (Some(scans), Some(odometry));
    Ok(v1::Batch { reference_time_us, mounts, scans, odometry, dropped, suspected })
}

/// The delta from a base to a batch; `base_number` is the question the service keeps it by. `None` where no delta gives
/// the batch to the bit: send it whole.
#[must_use]
pub fn between(base_number: u64, base: &v1::Batch, batch: &v1::Batch) -> Option<v1::BatchDelta> {
    let shift_us = base.reference_time_us.checked_sub(batch.reference_time_us)?;
    let (scans, way) = (batch.scans.as_ref()?, batch.odometry.as_ref()?);
    let (scans_from, scans_kept) = scans::common(base.scans.as_ref()?, scans, shift_us);
    let (poses_from, poses_kept) = poses_common(base.odometry.as_ref()?, way, shift_us);
    let mut odometry = poses_behind(way, poses_kept);
    let packed = packed::pack(&odometry);
    if packed.is_some() {
        odometry = qualities(way);
    }
    let delta = v1::BatchDelta {
        base: base_number,
        reference_time_us: batch.reference_time_us,
        scans_from: u32::try_from(scans_from).ok()?,
        scans_kept: u32::try_from(scans_kept).ok()?,
        scans: Some(scans::behind(scans, scans_kept)?),
        poses_from: u32::try_from(poses_from).ok()?,
        poses_kept: u32::try_from(poses_kept).ok()?,
        odometry: Some(odometry),
        packed,
        mounts: if batch.mounts == base.mounts { Vec::new() } else { batch.mounts.clone() },
        dropped: batch.dropped,
        suspected: batch.suspected.clone(),
    };
    // Whatever the base lacks, the batch is never another one.
    let same = applied(base, delta.clone()).is_ok_and(|made| made == *batch);
    same.then_some(delta)
}

/// `count` rows of a column behind the first `from`.
fn rows<T: Copy>(column: &[T], (from, count): (usize, usize), field: &'static str) -> Result<Vec<T>, Unfit> {
    let end = from.checked_add(count);
    let kept = end.and_then(|end| column.get(from..end)).ok_or(Unfit { field, problem: BEYOND })?;
    Ok(kept.to_vec())
}

/// Times relative to the base's reference time become relative to the batch's.
fn shifted(mut times: Vec<i64>, shift_us: i64, field: &'static str) -> Result<Vec<i64>, Unfit> {
    for time in &mut times {
        *time = time.checked_add(shift_us).ok_or(Unfit { field, problem: TIME })?;
    }
    Ok(times)
}

fn poses_applied(
    base: Option<&v1::Odometry>,
    kept: (usize, usize),
    shift_us: i64,
    new: v1::Odometry,
) -> Result<v1::Odometry, Unfit> {
    let empty = v1::Odometry::default();
    let (base, field) = (base.unwrap_or(&empty), "poses_kept");
    let mut time_offset_us = shifted(rows(&base.time_offset_us, kept, field)?, shift_us, field)?;
    time_offset_us.extend(&new.time_offset_us);
    let column = |base: &[f64], new: &[f64]| {
        let mut all = rows(base, kept, field)?;
        all.extend(new);
        Ok(all)
    };
    Ok(v1::Odometry {
        time_offset_us,
        x_m: column(&base.x_m, &new.x_m)?,
        y_m: column(&base.y_m, &new.y_m)?,
        yaw_rad: column(&base.yaw_rad, &new.yaw_rad)?,
        ..new
    })
}

/// Where the base's poses that the way begins with lie, and how many they are.
fn poses_common(base: &v1::Odometry, way: &v1::Odometry, shift_us: i64) -> (usize, usize) {
    let pose = |way: &v1::Odometry, row: usize, shift_us: i64| {
        let [x, y, yaw] = [&way.x_m, &way.y_m, &way.yaw_rad].map(|column| column.get(row).copied());
        let bits = |value: Option<f64>| value.map(f64::to_bits);
        way.time_offset_us.get(row).map(|t| (t.wrapping_add(shift_us), bits(x), bits(y), bits(yaw)))
    };
    let first = pose(way, 0, 0);
    let Some(from) = (0..base.time_offset_us.len()).find(|row| pose(base, *row, shift_us) == first) else {
        return (0, 0);
    };
    let most = (base.time_offset_us.len() - from).min(way.time_offset_us.len());
    (from, (0..most).take_while(|row| pose(base, from + row, shift_us) == pose(way, *row, 0)).count())
}

/// How good odometry is, without poses.
fn qualities(way: &v1::Odometry) -> v1::Odometry {
    let v1::Odometry { sigma_velocity_mps, sigma_velocity_fraction, sigma_yaw_rate_radps, .. } = *way;
    v1::Odometry {
        sigma_velocity_mps,
        sigma_velocity_fraction,
        sigma_yaw_rate_radps,
        ..v1::Odometry::default()
    }
}

/// The poses of a way behind the first ones.
fn poses_behind(way: &v1::Odometry, first: usize) -> v1::Odometry {
    let behind = |column: &[f64]| column.iter().skip(first).copied().collect();
    v1::Odometry {
        time_offset_us: way.time_offset_us.iter().skip(first).copied().collect(),
        x_m: behind(&way.x_m),
        y_m: behind(&way.y_m),
        yaw_rad: behind(&way.yaw_rad),
        ..qualities(way)
    }
}

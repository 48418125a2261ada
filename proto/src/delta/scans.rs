//! The scans of a batch: a run of the base's, and the new ones behind them.

use super::{BEYOND, Unfit, rows, shifted};
use crate::v1;

const FIELD: &str = "scans_kept";

/// A run of the base's scans, and the new ones.
pub(super) fn applied(
    base: Option<&v1::Scans>,
    kept: (usize, usize),
    shift_us: i64,
    new: v1::Scans,
) -> Result<v1::Scans, Unfit> {
    let empty = v1::Scans::default();
    let base = base.unwrap_or(&empty);
    let own = detections(base, kept).ok_or(Unfit { field: FIELD, problem: BEYOND })?;
    let mut time_offset_us = shifted(rows(&base.time_offset_us, kept, FIELD)?, shift_us, FIELD)?;
    time_offset_us.extend(new.time_offset_us);
    Ok(v1::Scans {
        sensor: joined(&base.sensor, kept, new.sensor)?,
        time_offset_us,
        detection_count: joined(&base.detection_count, kept, new.detection_count)?,
        range_m: joined(&base.range_m, own, new.range_m)?,
        azimuth_rad: joined(&base.azimuth_rad, own, new.azimuth_rad)?,
        radial_speed_mps: optional(&base.radial_speed_mps, own, new.radial_speed_mps)?,
        rcs_dbsm: optional(&base.rcs_dbsm, own, new.rcs_dbsm)?,
        elevation_rad: optional(&base.elevation_rad, own, new.elevation_rad)?,
        detection_time_offset_us: optional(
            &base.detection_time_offset_us,
            own,
            new.detection_time_offset_us,
        )?,
    })
}

fn joined<T: Copy>(base: &[T], kept: (usize, usize), new: Vec<T>) -> Result<Vec<T>, Unfit> {
    let mut all = rows(base, kept, FIELD)?;
    all.extend(new);
    Ok(all)
}

/// The same of a column that may be left out.
fn optional<T: Copy>(base: &[T], kept: (usize, usize), new: Vec<T>) -> Result<Vec<T>, Unfit> {
    if base.is_empty() { Ok(new) } else { joined(base, kept, new) }
}

/// The rows of the detections of a run of scans: where they begin, and how many they are.
fn detections(scans: &v1::Scans, (from, count): (usize, usize)) -> Option<(usize, usize)> {
    let counts = &scans.detection_count;
    let before = counts.get(..from)?.iter().try_fold(0_usize, |sum, n| sum.checked_add(*n as usize))?;
    let own = counts.get(from..from.checked_add(count)?)?;
    Some((before, own.iter().try_fold(0_usize, |sum, n| sum.checked_add(*n as usize))?))
}

/// Where the base's scans that the batch begins with lie, and how many they are. A late scan among them ends the run.
pub(super) fn common(base: &v1::Scans, batch: &v1::Scans, shift_us: i64) -> (usize, usize) {
    let head = |scans: &v1::Scans, row: usize, shift_us: i64| {
        let time_us = scans.time_offset_us.get(row)?.wrapping_add(shift_us);
        Some((*scans.sensor.get(row)?, time_us, *scans.detection_count.get(row)?))
    };
    let Some(first) = head(batch, 0, 0) else { return (0, 0) };
    let Some(from) = (0..base.sensor.len()).find(|row| head(base, *row, shift_us) == Some(first)) else {
        return (0, 0);
    };
    let same =
        |row: &usize| head(batch, *row, 0).is_some_and(|scan| head(base, from + row, shift_us) == Some(scan));
    (from, (0..batch.sensor.len()).take_while(same).count())
}

/// The scans of a batch behind the first ones.
pub(super) fn behind(scans: &v1::Scans, first: usize) -> Option<v1::Scans> {
    let (_, before) = detections(scans, (0, first))?;
    Some(v1::Scans {
        sensor: scans.sensor.get(first..)?.to_vec(),
        time_offset_us: scans.time_offset_us.get(first..)?.to_vec(),
        detection_count: scans.detection_count.get(first..)?.to_vec(),
        range_m: scans.range_m.get(before..)?.to_vec(),
        azimuth_rad: scans.azimuth_rad.get(before..)?.to_vec(),
        radial_speed_mps: tail(&scans.radial_speed_mps, before)?,
        rcs_dbsm: tail(&scans.rcs_dbsm, before)?,
        elevation_rad: tail(&scans.elevation_rad, before)?,
        detection_time_offset_us: tail(&scans.detection_time_offset_us, before)?,
    })
}

fn tail<T: Copy>(column: &[T], before: usize) -> Option<Vec<T>> {
    if column.is_empty() { Some(Vec::new()) } else { Some(column.get(before..)?.to_vec()) }
}

//! A scan that took its time, as several that did not.
//!
//! A spinning radar takes a quarter of a second for a turn, in which a car drives metres. Cut into slices of
//! [`SLICE_US`], each with the mean time of its detections, a turn becomes scans like any others: gated by the velocity, placed by the
//! pose and reckoned with the drift of their own time. What remains is the way of half a slice: 15 mm at 30 m/s,
//! and nothing where a slice holds one time only.

use std::collections::BTreeMap;

use super::{Scan, ScanView};

/// The longest slice, microseconds.
pub const SLICE_US: i32 = 1_000;

/// Are all detections of the scan's own time?
#[must_use]
pub fn at_once(scan: &ScanView<'_>) -> bool {
    scan.detection_time_offset_us.iter().all(|offset| *offset == 0)
}

/// The slices of a scan, oldest first, without times of their detections; the scan itself, where it was taken at
/// once. Rows stay in order within a slice.
#[must_use]
pub fn slices(scan: &ScanView<'_>) -> Vec<Scan> {
    let mut rows_by_slice: BTreeMap<i32, Vec<usize>> = BTreeMap::new();
    if at_once(scan) {
        return vec![Scan { detection_time_offset_us: Vec::new(), ..(*scan).to_owned() }];
    }
    for (row, offset_us) in scan.detection_time_offset_us.iter().enumerate() {
        rows_by_slice.entry(offset_us.div_euclid(SLICE_US)).or_default().push(row);
    }
    rows_by_slice.into_values().map(|rows| slice(scan, &rows)).collect()
}

/// The scans with those that took their time cut into slices; `None` where all were taken at once.
pub(crate) fn sliced<'a>(scans: impl Iterator<Item = ScanView<'a>> + Clone) -> Option<Vec<Scan>> {
    let took_time = scans.clone().any(|scan| !at_once(&scan));
    took_time.then(|| scans.flat_map(|scan| slices(&scan)).collect())
}

/// Some rows of a scan, at their mean time.
fn slice(scan: &ScanView<'_>, rows: &[usize]) -> Scan {
    let column = |values: &[f32]| rows.iter().filter_map(|row| values.get(*row).copied()).collect();
    let offsets = rows.iter().map(|row| i64::from(scan.detection_time_offset_us[*row]));
    let mean_us = offsets.sum::<i64>().div_euclid(rows.len().max(1) as i64);
    Scan {
        sensor: scan.sensor,
        time_us: scan.time_us.saturating_add(mean_us),
        range_m: column(scan.range_m),
        azimuth_rad: column(scan.azimuth_rad),
        radial_speed_mps: column(scan.radial_speed_mps),
        elevation_rad: column(scan.elevation_rad),
        ..Scan::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Catches a detection that is lost, doubled, put beside another one's azimuth, or placed at another time
        /// than its own.
        #[test]
        fn every_detection_comes_once_within_a_slice_of_its_time(
            offsets in prop::collection::vec(-300_000..300_000_i32, 1..200),
        ) {
            let scan = Scan {
                sensor: 3,
                time_us: 7_000_000,
                range_m: (0..offsets.len()).map(|row| row as f32).collect(),
                azimuth_rad: (0..offsets.len()).map(|row| -(row as f32)).collect(),
                detection_time_offset_us: offsets.clone(),
                ..Scan::default()
            };
            let found = slices(&ScanView::from(&scan));
            let rows = found.iter().flat_map(|slice| slice.range_m.iter().map(move |r| (*r as usize, slice)));
            let mut seen: Vec<usize> = rows.clone().map(|(row, _)| row).collect();
            for (row, slice) in rows {
                let off_us = slice.time_us - scan.time_us - i64::from(offsets[row]);
                prop_assert!(off_us.abs() <= i64::from(SLICE_US), "{off_us}");
                prop_assert_eq!(slice.sensor, 3);
            }
            seen.sort_unstable();
            prop_assert_eq!(seen, (0..offsets.len()).collect::<Vec<_>>());
            prop_assert!(found.iter().all(|slice| slice.azimuth_rad.iter().zip(&slice.range_m).all(|(a, r)| (*a + r).abs() < f32::EPSILON)));
            prop_assert!(found.windows(2).all(|pair| pair[0].time_us < pair[1].time_us));
        }
    }

    /// Catches a scan that changes, or is cut, although it took no time.
    #[test]
    fn a_scan_that_took_no_time_is_its_own_slice() {
        let scan =
            Scan { time_us: 5, range_m: vec![1.0, 2.0], azimuth_rad: vec![0.1, 0.2], ..Scan::default() };
        let zero = Scan { detection_time_offset_us: vec![0, 0], ..scan.clone() };
        assert_eq!(slices(&ScanView::from(&zero)), std::slice::from_ref(&scan));
        assert_eq!(slices(&ScanView::from(&scan)), std::slice::from_ref(&scan));
        assert_eq!(sliced([ScanView::from(&zero)].into_iter()), None);
    }
}

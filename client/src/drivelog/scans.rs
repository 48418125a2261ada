//! The scans of a log, made whole: values that are missing, doubled scans, scans out of order.

use std::collections::HashMap;
use std::f32::consts::FRAC_PI_2;

use echofix_core::scan::Scan;

use super::order::{longest_increasing, without_the_lonely};
use super::{Flaws, Problem};

/// In a column of time offsets: not given. (In columns of numbers NaN says so.)
pub(super) const NO_OFFSET: i32 = i32::MIN;

/// Scans as they are read, each with its place in the part of the log that holds them.
pub(super) struct ReadScans<'a> {
    pub part: &'a str,
    pub scans: Vec<(Scan, u64)>,
}

impl ReadScans<'_> {
    /// The scans in order of time, without those that are there already; what is left out is told.
    pub(super) fn finish(mut self, flaws: &mut Flaws) -> Vec<Scan> {
        for (scan, place) in &mut self.scans {
            make_whole(scan, |problem| flaws.skip(self.part, *place, problem));
        }
        if !self.scans.is_sorted_by_key(|(scan, _)| scan.time_us) {
            let late = self.out_of_place();
            if late > 0 {
                flaws.note(format!(
                    "{}: {late} scans stood at another place than in time; put in order",
                    self.part
                ));
            }
            self.scans.sort_by_key(|(scan, _)| scan.time_us);
        }
        let times: Vec<i64> = self.scans.iter().map(|(scan, _)| scan.time_us).collect();
        let ordered = without_the_lonely(self.scans, &times, |(scan, place), before_us| {
            flaws.skip(self.part, *place, &Problem::OutOfOrder { time_us: scan.time_us, before_us });
        });
        let mut scans: Vec<Scan> = Vec::with_capacity(ordered.len());
        for (scan, place) in ordered {
            let of_its_time = scans.iter().rev().take_while(|other| other.time_us == scan.time_us);
            if of_its_time.into_iter().any(|other| *other == scan) {
                flaws.skip(self.part, place, &Problem::Doubled);
            } else {
                scans.push(scan);
            }
        }
        scans
    }

    /// How many scans would have to be moved so that each radar's stand in order.
    fn out_of_place(&self) -> usize {
        let mut of_radar: HashMap<usize, Vec<(i64, usize)>> = HashMap::new();
        for (number, (scan, _)) in self.scans.iter().enumerate() {
            of_radar.entry(scan.sensor).or_default().push((scan.time_us, number));
        }
        let in_place = of_radar
            .values()
            .map(|times| longest_increasing(times).into_iter().filter(|stays| *stays).count());
        self.scans.len() - in_place.sum::<usize>()
    }
}

/// Drops the detections of a scan that cannot be used, and the optional columns that most of its detections lack.
pub(super) fn make_whole(scan: &mut Scan, mut tell: impl FnMut(&Problem)) {
    let mut fine: Vec<Option<Problem>> = (0..scan.len()).map(|row| unusable(scan, row)).collect();
    let few = |given: usize| 2 * given < scan.range_m.len().max(1);
    for (column, values) in [
        ("radial_speed_mps", &mut scan.radial_speed_mps),
        ("elevation_rad", &mut scan.elevation_rad),
        ("rcs_dbsm", &mut scan.rcs_dbsm),
    ] {
        if few(values.iter().filter(|value| value.is_finite()).count()) {
            values.clear();
        }
        // Nothing reads a cross section yet: it is no reason to lose a detection.
        if column == "rcs_dbsm" && values.iter().any(|value| !value.is_finite()) {
            values.clear();
        }
        lacking(column, values, |value| value.is_finite(), &mut fine);
    }
    let offsets = &mut scan.detection_time_offset_us;
    if few(offsets.iter().filter(|offset| **offset != NO_OFFSET).count()) {
        offsets.clear();
    }
    lacking("detection_time_offset_us", offsets, |offset| *offset != NO_OFFSET, &mut fine);
    if fine.iter().any(Option::is_some) {
        fine.iter().flatten().for_each(&mut tell);
        scan.retain(|_, row| fine[row].is_none());
    }
}

/// Marks the rows that lack a value which others have.
fn lacking<T>(column: &'static str, values: &[T], given: impl Fn(&T) -> bool, fine: &mut [Option<Problem>]) {
    for (value, fine) in values.iter().zip(fine) {
        if !given(value) && fine.is_none() {
            *fine = Some(Problem::PartialColumn { column });
        }
    }
}

/// Why a detection cannot be used, whatever the others have.
fn unusable(scan: &Scan, row: usize) -> Option<Problem> {
    let range_m = scan.range_m[row];
    if !range_m.is_finite() || !scan.azimuth_rad[row].is_finite() {
        return Some(Problem::NotFinite);
    }
    if range_m < 0.0 {
        return Some(Problem::NegativeRange { range_m });
    }
    let elevation_rad = *scan.elevation_rad.get(row)?;
    (elevation_rad.abs() > FRAC_PI_2).then_some(Problem::NoElevation { elevation_rad })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(time_us: i64, radial_speed_mps: &[f32]) -> Scan {
        let n = radial_speed_mps.len();
        Scan {
            time_us,
            range_m: (1..).map(|i| i as f32).take(n).collect(),
            azimuth_rad: vec![0.1; n],
            radial_speed_mps: radial_speed_mps.to_vec(),
            ..Scan::default()
        }
    }

    fn finish(scans: Vec<Scan>) -> (Vec<Scan>, Flaws) {
        let mut flaws = Flaws::default();
        let scans = ReadScans { part: "/radar/scans", scans: scans.into_iter().zip(1..).collect() };
        (scans.finish(&mut flaws), flaws)
    }

    /// Catches: a scan that is lost for one detection, or a detection for a value that nobody reads.
    #[test]
    fn of_a_scan_only_what_is_bad_is_dropped() {
        let nan = f32::NAN;
        let (scans, flaws) = finish(vec![scan(1, &[1.0, nan, 3.0]), scan(2, &[nan, nan, 3.0])]);
        assert_eq!(
            (&scans[0].range_m[..], &scans[0].radial_speed_mps[..]),
            (&[1.0, 3.0][..], &[1.0, 3.0][..])
        );
        assert_eq!((scans[1].len(), scans[1].radial_speed_mps.len()), (3, 0));
        assert_eq!((flaws.count("incomplete"), flaws.total()), (1, 1), "{flaws}");
        let mut bad = scan(3, &[1.0, 2.0, 3.0, 4.0]);
        (bad.range_m[0], bad.range_m[1], bad.azimuth_rad[2]) = (-1.0, f32::INFINITY, nan);
        bad.rcs_dbsm = vec![1.0, nan, 1.0, nan];
        let (scans, flaws) = finish(vec![bad]);
        assert_eq!((scans[0].len(), scans[0].rcs_dbsm.len()), (1, 0));
        assert!(scans[0].validate().is_ok());
        assert_eq!((flaws.count("not_finite"), flaws.count("out_of_range")), (2, 1), "{flaws}");
    }

    /// Catches: scans that count twice, and two different ones of the same time that are taken for one.
    #[test]
    fn scans_are_sorted_and_doubled_ones_told() {
        let (scans, flaws) =
            finish(vec![scan(1, &[1.0]), scan(3, &[1.0]), scan(2, &[1.0]), scan(3, &[1.0]), scan(3, &[2.0])]);
        assert_eq!(scans.iter().map(|s| s.time_us).collect::<Vec<_>>(), [1, 2, 3, 3]);
        assert_eq!((flaws.count("doubled"), flaws.skipped[0].first), (1, 4), "{flaws}");
        assert!(flaws.to_string().contains("put in order"), "{flaws}");
    }
}

//! One radar scan, and where its radar sits on the vehicle.
//!
//! - [`Scan`]: its own columns; [`ScanView`]: somebody else's.
//! - [`slices`]: a scan that took its time, as several that did not.

pub mod slices;

use std::f32::consts::FRAC_PI_2;

use crate::pose::Pose2;

/// Detections of one sensor at one time, as columns of equal length.
///
/// All columns but range and azimuth may be empty when the sensor does not measure them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scan {
    /// Index into the vehicle's list of sensor mounts.
    pub sensor: usize,
    /// Time of the scan, microseconds since the Unix epoch (UTC).
    pub time_us: i64,
    /// Range, metres; the slant range where there are elevations, else along the ground.
    pub range_m: Vec<f32>,
    /// Azimuth, radians, counter-clockwise from the sensor's boresight.
    pub azimuth_rad: Vec<f32>,
    /// Radial speed relative to the sensor, metres per second, positive away from it.
    pub radial_speed_mps: Vec<f32>,
    /// Elevation, radians above the body's plane. The [gate](crate::gate) brings range and radial speed to the
    /// ground with it and drops what is too low or too high.
    pub elevation_rad: Vec<f32>,
    /// Time of the detection relative to the scan's, microseconds: a spinning radar takes a turn for a scan.
    /// [`slices`] place each detection from where the body was at its own time.
    pub detection_time_offset_us: Vec<i32>,
    /// Radar cross section, decibel square metres. Recorded, not read yet: drive logs and the contract carry
    /// it, everything behind them leaves it out.
    pub rcs_dbsm: Vec<f32>,
}

/// A scan whose columns belong to somebody else: rows of longer columns, or a [`Scan`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScanView<'a> {
    /// Index into the vehicle's list of sensor mounts.
    pub sensor: usize,
    /// Time of the scan, microseconds since the Unix epoch (UTC).
    pub time_us: i64,
    /// Range, metres.
    pub range_m: &'a [f32],
    /// Azimuth, radians, counter-clockwise from the sensor's boresight; as long as `range_m`.
    pub azimuth_rad: &'a [f32],
    /// Radial speed relative to the sensor, metres per second, positive away from it; as long, or
    /// empty when it is not measured.
    pub radial_speed_mps: &'a [f32],
    /// Elevation, radians above the body's plane; as long, or empty when it is not measured.
    pub elevation_rad: &'a [f32],
    /// Time of the detection relative to the scan's, microseconds; as long, or empty when all were taken at once.
    pub detection_time_offset_us: &'a [i32],
}

impl<'a> From<&'a Scan> for ScanView<'a> {
    fn from(scan: &'a Scan) -> Self {
        let Scan { sensor, time_us, range_m, azimuth_rad, radial_speed_mps, elevation_rad, .. } = scan;
        let detection_time_offset_us = &scan.detection_time_offset_us;
        let (sensor, time_us) = (*sensor, *time_us);
        Self {
            sensor,
            time_us,
            range_m,
            azimuth_rad,
            radial_speed_mps,
            elevation_rad,
            detection_time_offset_us,
        }
    }
}

impl ScanView<'_> {
    /// A scan with these columns of its own, without cross sections.
    #[must_use]
    pub fn to_owned(self) -> Scan {
        Scan {
            sensor: self.sensor,
            time_us: self.time_us,
            range_m: self.range_m.to_vec(),
            azimuth_rad: self.azimuth_rad.to_vec(),
            radial_speed_mps: self.radial_speed_mps.to_vec(),
            elevation_rad: self.elevation_rad.to_vec(),
            detection_time_offset_us: self.detection_time_offset_us.to_vec(),
            rcs_dbsm: Vec::new(),
        }
    }
}

/// The scans in order of time, and of sensor where times are equal; `None` when they are in that order already.
pub(crate) fn in_time_order<'a>(
    scans: impl Iterator<Item = ScanView<'a>> + Clone,
) -> Option<Vec<ScanView<'a>>> {
    let key = |scan: &ScanView<'_>| (scan.time_us, scan.sensor);
    if scans.clone().is_sorted_by_key(|scan| key(&scan)) {
        return None;
    }
    let mut sorted: Vec<_> = scans.collect();
    sorted.sort_by_key(key);
    Some(sorted)
}

/// Why a scan's columns cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Columns must be equally long; the optional ones may be empty.
    #[error(
        "column `{column}` has {found} values but `range_m` has {expected}; send columns of equal length"
    )]
    ColumnLength {
        /// The offending column.
        column: &'static str,
        /// Values in the column.
        found: usize,
        /// The length of `range_m`.
        expected: usize,
    },
    /// A value is NaN or infinite.
    #[error("column `{column}` holds a value that is not finite at row {row}; drop such detections")]
    NotFinite {
        /// The offending column.
        column: &'static str,
        /// The row of the first such value.
        row: usize,
    },
    /// A range is negative.
    #[error("`range_m` is negative at row {row}; ranges are distances from the sensor")]
    NegativeRange {
        /// The row of the first such value.
        row: usize,
    },
    /// An elevation beyond straight up or down.
    #[error(
        "`elevation_rad` is {value} at row {row}; elevations are radians, positive up, at most a right angle"
    )]
    NoElevation {
        /// The row of the first such value.
        row: usize,
        /// The value, as text.
        value: String,
    },
}

impl Error {
    /// The kind of error as one word.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::ColumnLength { .. } => "incomplete",
            Self::NotFinite { .. } => "not_finite",
            Self::NegativeRange { .. } | Self::NoElevation { .. } => "out_of_range",
        }
    }
}

impl Scan {
    /// Number of detections.
    #[must_use]
    pub fn len(&self) -> usize {
        self.range_m.len()
    }

    /// True when nothing was detected.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.range_m.is_empty()
    }

    /// The detection's position in the sensor's frame, metres (x along the boresight, y left), in double
    /// precision: what [`crate::pose::Pose2::transform`] takes.
    #[must_use]
    pub fn sensor_point(&self, row: usize) -> [f64; 2] {
        let (range, azimuth) = (f64::from(self.range_m[row]), f64::from(self.azimuth_rad[row]));
        [range * azimuth.cos(), range * azimuth.sin()]
    }

    /// Checks lengths, finiteness and the sign of the ranges.
    ///
    /// # Errors
    /// The first column that breaks a rule.
    pub fn validate(&self) -> Result<(), Error> {
        let expected = self.range_m.len();
        let columns = [
            ("range_m", &self.range_m, true),
            ("azimuth_rad", &self.azimuth_rad, true),
            ("radial_speed_mps", &self.radial_speed_mps, false),
            ("elevation_rad", &self.elevation_rad, false),
            ("rcs_dbsm", &self.rcs_dbsm, false),
        ];
        let (column, found) = ("detection_time_offset_us", self.detection_time_offset_us.len());
        if found != expected && found != 0 {
            return Err(Error::ColumnLength { column, found, expected });
        }
        for (column, values, required) in columns {
            let found = values.len();
            if found != expected && (required || found != 0) {
                return Err(Error::ColumnLength { column, found, expected });
            }
            if let Some(row) = first_row(values, |v| !v.is_finite()) {
                return Err(Error::NotFinite { column, row });
            }
        }
        if let Some(row) = first_row(&self.range_m, |r| r < 0.0) {
            return Err(Error::NegativeRange { row });
        }
        match first_row(&self.elevation_rad, |elevation| elevation.abs() > FRAC_PI_2) {
            Some(row) => Err(Error::NoElevation { row, value: self.elevation_rad[row].to_string() }),
            None => Ok(()),
        }
    }

    /// Retains the rows for which `keep` is true, in order.
    pub fn retain(&mut self, mut keep: impl FnMut(&Self, usize) -> bool) {
        let retained: Vec<bool> = (0..self.len()).map(|row| keep(self, row)).collect();
        for column in [
            &mut self.range_m,
            &mut self.azimuth_rad,
            &mut self.radial_speed_mps,
            &mut self.elevation_rad,
            &mut self.rcs_dbsm,
        ] {
            filter(column, &retained);
        }
        filter(&mut self.detection_time_offset_us, &retained);
    }
}

/// Keeps what is retained of a column, which may be empty.
fn filter<T>(column: &mut Vec<T>, retained: &[bool]) {
    let mut rows = retained.iter();
    column.retain(|_| rows.next().copied().unwrap_or(false));
}

/// The first row for which `wrong` holds.
pub fn first_row(column: &[f32], wrong: impl Fn(f32) -> bool) -> Option<usize> {
    // Columns are nearly always right, and a loop that does not stop early is many times faster.
    let any = column.iter().fold(false, |any, value| any | wrong(*value));
    if any { column.iter().position(|value| wrong(*value)) } else { None }
}

/// Where a radar sits on the body: metres from the body's origin, boresight yaw from forward.
pub type Mount = Pose2;

#[cfg(test)]
mod tests {
    use super::*;

    fn scan() -> Scan {
        Scan { range_m: vec![1.0, 2.0, 60.0], azimuth_rad: vec![0.0, 0.5, -0.5], ..Scan::default() }
    }

    #[test]
    fn optional_columns_may_be_missing_but_not_short() {
        let mut s = scan();
        assert_eq!(s.validate(), Ok(()));
        s.rcs_dbsm = vec![1.0];
        assert_eq!(s.validate(), Err(Error::ColumnLength { column: "rcs_dbsm", found: 1, expected: 3 }));
    }

    #[test]
    fn bad_values_are_named_with_their_row() {
        let mut s = scan();
        s.azimuth_rad[1] = f32::NAN;
        assert_eq!(s.validate(), Err(Error::NotFinite { column: "azimuth_rad", row: 1 }));
        let mut s = scan();
        s.range_m[2] = -1.0;
        assert_eq!(s.validate(), Err(Error::NegativeRange { row: 2 }));
    }

    /// Catches an elevation in degrees that goes through.
    #[test]
    fn elevations_and_times_are_checked() {
        let mut s = scan();
        s.elevation_rad = vec![0.1, -2.0, 0.0];
        assert!(
            s.validate()
                .unwrap_err()
                .to_string()
                .contains("`elevation_rad` is -2 at row 1; elevations are radians")
        );
        s.elevation_rad = vec![0.1, -0.2, 0.0];
        s.detection_time_offset_us = vec![3];
        let column = "detection_time_offset_us";
        assert_eq!(s.validate(), Err(Error::ColumnLength { column, found: 1, expected: 3 }));
    }

    #[test]
    fn retain_filters_every_column_that_is_there() {
        let mut s = scan();
        s.radial_speed_mps = vec![-1.0, -2.0, -3.0];
        s.detection_time_offset_us = vec![1, 2, 3];
        s.retain(|s, row| s.range_m[row] < 50.0);
        assert_eq!(s.detection_time_offset_us, [1, 2]);
        assert_eq!(s.range_m, [1.0, 2.0]);
        assert_eq!(s.radial_speed_mps, [-1.0, -2.0]);
        assert!(s.rcs_dbsm.is_empty());
    }
}

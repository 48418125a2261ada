//! Scans stay in the columns they came in.

use echofix_core::scan::{self, Scan, ScanView, first_row};
use echofix_proto::v1;

use super::{InvalidField, MAX_SCANS, angle, limit, require, same_length, times};

/// Scans in columns that are sound: finite, of matching lengths, of radars that are mounted.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanColumns {
    sensor: Vec<u32>,
    time_us: Vec<i64>,
    detection_count: Vec<u32>,
    /// The detections of all scans, one after the other.
    detections: Scan,
}

impl ScanColumns {
    /// Each scan with its own rows of the detection columns, in the order they came. Those without
    /// any are left out.
    pub fn iter(&self) -> impl Iterator<Item = ScanView<'_>> + Clone {
        let ends = self.detection_count.iter().scan(0, |end, count| {
            *end += *count as usize;
            Some((*end - *count as usize)..*end)
        });
        let scans = self.sensor.iter().zip(&self.time_us).zip(ends).filter(|(_, rows)| !rows.is_empty());
        scans.map(|((sensor, time_us), rows)| ScanView {
            sensor: *sensor as usize,
            time_us: *time_us,
            range_m: &self.detections.range_m[rows.clone()],
            azimuth_rad: &self.detections.azimuth_rad[rows.clone()],
            // An optional column may be empty.
            radial_speed_mps: self.detections.radial_speed_mps.get(rows.clone()).unwrap_or_default(),
            elevation_rad: self.detections.elevation_rad.get(rows.clone()).unwrap_or_default(),
            detection_time_offset_us: self.detections.detection_time_offset_us.get(rows).unwrap_or_default(),
        })
    }

    /// The same, each with columns of its own and without cross sections.
    #[must_use]
    pub fn split(&self) -> Vec<Scan> {
        self.iter().map(ScanView::to_owned).collect()
    }
}

/// Scans as columns, in the order they came. `mounts` is the number of radars.
///
/// # Errors
/// The first column that breaks a rule.
pub fn scans(
    columns: v1::Scans,
    reference_time_us: i64,
    mounts: usize,
    field: &str,
) -> Result<ScanColumns, InvalidField> {
    let at = |name: &str| format!("{field}.{name}");
    let v1::Scans { sensor, time_offset_us, detection_count, range_m, azimuth_rad, .. } = columns;
    require(!sensor.is_empty(), &at("sensor"), "is empty; send at least one scan")?;
    limit(sensor.len(), MAX_SCANS, &at("sensor"))?;
    same_length(time_offset_us.len(), sensor.len(), &at("time_offset_us"), "sensor")?;
    same_length(detection_count.len(), sensor.len(), &at("detection_count"), "sensor")?;
    if let Some(row) = sensor.iter().position(|sensor| *sensor as usize >= mounts) {
        let described = format!("names sensor {}, but {mounts} are mounted", sensor[row]);
        return Err(InvalidField::new(format!("{}[{row}]", at("sensor")), described));
    }
    let counted: u64 = detection_count.iter().map(|count| u64::from(*count)).sum();
    if counted != range_m.len() as u64 {
        let described = format!("adds up to {counted}, but `range_m` has {} values", range_m.len());
        return Err(InvalidField::new(at("detection_count"), described));
    }
    let time_us = times(time_offset_us, reference_time_us, &at("time_offset_us"))?;
    let detections = Scan {
        range_m,
        azimuth_rad,
        radial_speed_mps: columns.radial_speed_mps,
        elevation_rad: columns.elevation_rad,
        detection_time_offset_us: columns.detection_time_offset_us,
        rcs_dbsm: columns.rcs_dbsm,
        ..Scan::default()
    };
    detections.validate().map_err(|error| InvalidField::new(at(column(&error)), error))?;
    if let Some(row) = first_row(&detections.azimuth_rad, |azimuth| !angle(f64::from(azimuth))) {
        return Err(InvalidField::new(format!("{}[{row}]", at("azimuth_rad")), "is not an angle in radians"));
    }
    Ok(ScanColumns { sensor, time_us, detection_count, detections })
}

/// The column a scan's error is about.
fn column(error: &scan::Error) -> &'static str {
    match error {
        scan::Error::ColumnLength { column, .. } | scan::Error::NotFinite { column, .. } => column,
        scan::Error::NegativeRange { .. } => "range_m",
        scan::Error::NoElevation { .. } => "elevation_rad",
    }
}

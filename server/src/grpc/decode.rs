//! Columns of the contract to values of the core. Whatever passes is finite, bounded and of
//! matching lengths; whatever does not is named by its path.

use echofix_core::convention::Convention;
use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::odometry::{self, OdometryQuality, Trajectory};
use echofix_core::own_error::MountSigma;
use echofix_core::pose::Pose2;
use echofix_core::scan::Mount;
use echofix_core::time::DAY_US;
use echofix_proto::v1;

mod scans;
mod told;
mod uncertainty;

pub use scans::{ScanColumns, scans};
pub use told::Told;
pub use uncertainty::{Uncertainty, uncertainty};

pub use super::invalid_field::InvalidField;
use super::invalid_field::{require, required};

/// Radars of one vehicle, at most.
pub const MAX_MOUNTS: usize = 64;
/// Scans of one message, at most.
pub const MAX_SCANS: usize = 16_384;
/// Poses of one message, at most.
pub const MAX_POSES: usize = 65_536;
/// The end of the last day that the map can count, in the year 2149, microseconds.
const END_OF_TIME_US: i64 = 65_535 * DAY_US;
/// Metres from the odometry frame's origin that no vehicle reaches.
const MAX_ODOMETRY_M: f64 = 1e7;
/// Metres from the body's origin that no radar is mounted at.
const MAX_MOUNT_M: f32 = 100.0;
/// One-sigma errors of odometry that say nothing any more.
const MAX_SIGMA_VELOCITY_MPS: f64 = 100.0;
const MAX_SIGMA_FRACTION: f64 = 10.0;
const MAX_SIGMA_YAW_RATE_RADPS: f64 = 10.0;
/// Radians, so that no sum of angles loses its precision.
const MAX_ANGLE_RAD: f64 = 1e3;

/// A batch whose columns are sound.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedBatch {
    /// Microseconds since the Unix epoch.
    pub reference_time_us: i64,
    /// Where the radars sit on the vehicle.
    pub mounts: Vec<Mount>,
    /// How well mounts and clocks are known, one a mount.
    pub mount_sigmas: Vec<MountSigma>,
    /// Scans, as they came.
    pub scans: ScanColumns,
    /// The vehicle's way in its odometry frame.
    pub odometry: Trajectory,
    /// How good the odometry is.
    pub quality: OdometryQuality,
    /// What the vehicle says of its data itself.
    pub told: Told,
}

/// A batch. `field` is its own path.
///
/// # Errors
/// The first field that breaks a rule.
pub fn batch(batch: Option<v1::Batch>, field: &str) -> Result<DecodedBatch, InvalidField> {
    let v1::Batch { reference_time_us, mounts, scans: columns, odometry: way, dropped, suspected } =
        required(batch, field)?;
    let at = |name: &str| format!("{field}.{name}");
    reference_time(reference_time_us, &at("reference_time_us"))?;
    let mount_sigmas = mount_sigmas(&mounts, &at("mounts"))?;
    let mounts = self::mounts(&mounts, &at("mounts"))?;
    let columns = required(columns, &at("scans"))?;
    let scans = scans(columns, reference_time_us, mounts.len(), &at("scans"))?;
    let way = required(way, &at("odometry"))?;
    let quality = quality(&way, &at("odometry"))?;
    let odometry = odometry(way, reference_time_us, &at("odometry"))?;
    let told = Told::of(dropped, &suspected);
    Ok(DecodedBatch { reference_time_us, mounts, mount_sigmas, scans, odometry, quality, told })
}

/// A time on a day that the map can count.
///
/// # Errors
/// When it lies before 1970 or after 2149.
pub fn reference_time(time_us: i64, field: &str) -> Result<(), InvalidField> {
    require(is_countable(time_us), field, UNCOUNTABLE)
}

const UNCOUNTABLE: &str = "must be microseconds since 1970, before the year 2149";

fn is_countable(time_us: i64) -> bool {
    (0..END_OF_TIME_US).contains(&time_us)
}

/// The radars of a vehicle.
///
/// # Errors
/// When there are none or too many, or one is not on the vehicle.
pub fn mounts(mounts: &[v1::SensorMount], field: &str) -> Result<Vec<Mount>, InvalidField> {
    require(!mounts.is_empty(), field, "is empty; send the mount of every radar")?;
    limit(mounts.len(), MAX_MOUNTS, field)?;
    let on_body = |m: f32| m.abs() <= MAX_MOUNT_M;
    let sound = |m: &v1::SensorMount| on_body(m.x_m) && on_body(m.y_m) && angle(f64::from(m.yaw_rad));
    if let Some(row) = mounts.iter().position(|mount| !sound(mount)) {
        return Err(InvalidField::new(
            format!("{field}[{row}]"),
            "must be finite and within 100 m of the body",
        ));
    }
    let mount = |m: &v1::SensorMount| Mount::new(m.x_m.into(), m.y_m.into(), m.yaw_rad.into());
    Ok(mounts.iter().map(mount).collect())
}

/// How well mounts and clocks are known; the contract's defaults where a message is silent.
///
/// # Errors
/// When a sigma is negative, not finite, or larger than any vehicle.
pub fn mount_sigmas(mounts: &[v1::SensorMount], field: &str) -> Result<Vec<MountSigma>, InvalidField> {
    let silent = MountSigma::default();
    let sigma = |m: &v1::SensorMount| MountSigma {
        time_s: m.sigma_time_s.map_or(silent.time_s, f64::from),
        position_m: m.sigma_position_m.map_or(silent.position_m, f64::from),
        yaw_rad: m.sigma_yaw_rad.map_or(silent.yaw_rad, f64::from),
    };
    let sound = |m: &MountSigma| {
        [m.time_s, m.position_m, m.yaw_rad].iter().all(|s| (0.0..=f64::from(MAX_MOUNT_M)).contains(s))
    };
    let sigmas: Vec<_> = mounts.iter().map(sigma).collect();
    match sigmas.iter().position(|m| !sound(m)) {
        Some(row) => Err(InvalidField::new(
            format!("{field}[{row}]"),
            "has a one-sigma error that is negative, not finite or above 100; leave out what is not known",
        )),
        None => Ok(sigmas),
    }
}

/// The vehicle's way in its odometry frame.
///
/// # Errors
/// The first column that breaks a rule.
pub fn odometry(
    columns: v1::Odometry,
    reference_time_us: i64,
    field: &str,
) -> Result<Trajectory, InvalidField> {
    let at = |name: &str| format!("{field}.{name}");
    let v1::Odometry { time_offset_us, x_m, y_m, yaw_rad, .. } = columns;
    limit(time_offset_us.len(), MAX_POSES, &at("time_offset_us"))?;
    for (name, column) in [("x_m", &x_m), ("y_m", &y_m), ("yaw_rad", &yaw_rad)] {
        same_length(column.len(), time_offset_us.len(), &at(name), "time_offset_us")?;
        bounded(column, if name == "yaw_rad" { MAX_ANGLE_RAD } else { MAX_ODOMETRY_M }, &at(name))?;
    }
    let times = times(time_offset_us, reference_time_us, &at("time_offset_us"))?;
    let poses = x_m.iter().zip(&y_m).zip(&yaw_rad).map(|((x, y), yaw)| Pose2::new(*x, *y, *yaw));
    Trajectory::new(times.into_iter().zip(poses)).map_err(|error| match error {
        odometry::Error::NotIncreasing { .. } => InvalidField::new(at("time_offset_us"), error),
        odometry::Error::NotFinite { .. } => InvalidField::new(field, error),
    })
}

/// How good odometry is; the default where it is silent.
fn quality(way: &v1::Odometry, field: &str) -> Result<OdometryQuality, InvalidField> {
    let silent = OdometryQuality::default();
    let stated = way.sigma_velocity_mps.or(way.sigma_velocity_fraction).is_some();
    let quality = OdometryQuality {
        velocity_mps: way.sigma_velocity_mps.unwrap_or(if stated { 0.0 } else { silent.velocity_mps }),
        velocity_fraction: way.sigma_velocity_fraction.unwrap_or(silent.velocity_fraction),
        yaw_rate_radps: way.sigma_yaw_rate_radps.unwrap_or(silent.yaw_rate_radps),
    };
    let within = quality.velocity_mps <= MAX_SIGMA_VELOCITY_MPS
        && quality.velocity_fraction <= MAX_SIGMA_FRACTION
        && quality.yaw_rate_radps <= MAX_SIGMA_YAW_RATE_RADPS;
    let problem = "must be sigmas that are not negative and at most 100 m/s, 10 times the velocity and 10 rad/s; \
         leave out what is not known";
    if quality.is_sound() && within {
        Ok(quality)
    } else {
        Err(InvalidField::new(format!("{field}.sigma"), problem))
    }
}

/// Absolute poses, oldest first.
///
/// # Errors
/// The first column that breaks a rule.
pub fn geo_poses(
    columns: &v1::PoseColumns,
    reference_time_us: i64,
    field: &str,
) -> Result<Vec<GeoPose>, InvalidField> {
    let at = |name: &str| format!("{field}.{name}");
    let rows = columns.time_offset_us.len();
    limit(rows, MAX_POSES, &at("time_offset_us"))?;
    let doubles = [
        ("latitude_deg", &columns.latitude_deg, 90.0),
        ("longitude_deg", &columns.longitude_deg, 180.0),
        ("yaw_rad", &columns.yaw_rad, MAX_ANGLE_RAD),
    ];
    for (name, column, most) in doubles {
        same_length(column.len(), rows, &at(name), "time_offset_us")?;
        bounded(column, most, &at(name)).map_err(|error| exchanged_or(error, name))?;
    }
    let sigmas = [("sigma_position_m", &columns.sigma_position_m), ("sigma_yaw_rad", &columns.sigma_yaw_rad)];
    for (name, column) in sigmas {
        same_length(column.len(), rows, &at(name), "time_offset_us")?;
        if let Some(row) = column.iter().position(|sigma| !(sigma.is_finite() && *sigma >= 0.0)) {
            return Err(InvalidField::new(format!("{}[{row}]", at(name)), "must be finite and not negative"));
        }
    }
    let times = times(columns.time_offset_us.clone(), reference_time_us, &at("time_offset_us"))?;
    if let Some(row) = times.windows(2).position(|pair| pair[1] <= pair[0]) {
        let field = format!("{}[{}]", at("time_offset_us"), row + 1);
        return Err(InvalidField::new(
            field,
            "does not come after the one before; send poses in order of time",
        ));
    }
    let pose = |row: usize| GeoPose {
        time_us: times[row],
        at: LatLon { lat_deg: columns.latitude_deg[row], lon_deg: columns.longitude_deg[row] },
        yaw_rad: columns.yaw_rad[row],
        sigma_position_m: columns.sigma_position_m[row].into(),
        sigma_yaw_rad: columns.sigma_yaw_rad[row].into(),
    };
    Ok((0..rows).map(pose).collect())
}

/// A position and its heading, radians counter-clockwise from true east.
///
/// # Errors
/// When it is missing or not a position on the globe.
pub fn geodetic_pose(pose: Option<v1::GeodeticPose>, field: &str) -> Result<(LatLon, f64), InvalidField> {
    let v1::GeodeticPose { latitude_deg, longitude_deg, yaw_rad } = required(pose, field)?;
    let at = lat_lon(latitude_deg, longitude_deg, field)?;
    require(angle(yaw_rad), &format!("{field}.yaw_rad"), "is not an angle in radians")?;
    Ok((at, yaw_rad))
}

/// A position on the globe.
///
/// # Errors
/// When it lies outside of the ranges of latitude or longitude.
pub fn lat_lon(lat_deg: f64, lon_deg: f64, field: &str) -> Result<LatLon, InvalidField> {
    let latitude = "must lie within -90 and 90 degrees";
    require(lat_deg.abs() <= 90.0, &format!("{field}.latitude_deg"), latitude)
        .map_err(|error| exchanged_or(error, "latitude_deg"))?;
    require(
        lon_deg.abs() <= 180.0,
        &format!("{field}.longitude_deg"),
        "must lie within -180 and 180 degrees",
    )?;
    Ok(LatLon { lat_deg, lon_deg })
}

/// A latitude that is none may be a longitude.
fn exchanged_or(error: InvalidField, name: &str) -> InvalidField {
    if name != "latitude_deg" {
        return error;
    }
    let question = Convention::LatLonSwapped.question();
    InvalidField::new(error.field, format!("{}; {question}", error.description))
}

/// Offsets become microseconds since the Unix epoch.
fn times(mut offsets_us: Vec<i64>, reference_time_us: i64, field: &str) -> Result<Vec<i64>, InvalidField> {
    for (row, offset_us) in offsets_us.iter_mut().enumerate() {
        *offset_us = reference_time_us.checked_add(*offset_us).unwrap_or(-1);
        if !is_countable(*offset_us) {
            return Err(InvalidField::new(format!("{field}[{row}]"), UNCOUNTABLE));
        }
    }
    Ok(offsets_us)
}

fn angle(rad: f64) -> bool {
    rad.abs() <= MAX_ANGLE_RAD
}

fn bounded(column: &[f64], most: f64, field: &str) -> Result<(), InvalidField> {
    // NaN is not within any range.
    match column.iter().position(|value| !(-most..=most).contains(value)) {
        Some(row) => {
            Err(InvalidField::new(format!("{field}[{row}]"), format!("must lie within -{most} and {most}")))
        }
        None => Ok(()),
    }
}

fn limit(rows: usize, most: usize, field: &str) -> Result<(), InvalidField> {
    require(rows <= most, field, &format!("has {rows} values; send at most {most} in one message"))
}

fn same_length(found: usize, expected: usize, field: &str, like: &str) -> Result<(), InvalidField> {
    let described = format!("has {found} values but `{like}` has {expected}; send columns of equal length");
    require(found == expected, field, &described)
}

#[cfg(test)]
mod tests;

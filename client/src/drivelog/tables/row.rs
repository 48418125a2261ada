//! The rows of each file. The columns' names are spelled out: they are the format, whatever the fields are called.

use echofix_core::drive::GeoPose;
use echofix_core::pose::Pose2;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
pub(super) struct VehicleRow {
    #[serde(rename = "vehicle")]
    pub vehicle: String,
}

#[derive(Serialize)]
pub(super) struct SensorRow {
    #[serde(rename = "sensor")]
    pub index: usize,
    #[serde(rename = "x_m")]
    pub x_m: f64,
    #[serde(rename = "y_m")]
    pub y_m: f64,
    #[serde(rename = "yaw_rad")]
    pub yaw_rad: f64,
}

/// A detection of a log without elevations and times of detections.
#[derive(Serialize)]
pub(super) struct DetectionRow {
    #[serde(rename = "time_us")]
    pub time_us: i64,
    #[serde(rename = "sensor")]
    pub sensor: usize,
    #[serde(rename = "range_m")]
    pub range_m: Option<f32>,
    #[serde(rename = "azimuth_rad")]
    pub azimuth_rad: Option<f32>,
    #[serde(rename = "radial_speed_mps")]
    pub radial_speed_mps: Option<f32>,
    #[serde(rename = "rcs_dbsm")]
    pub rcs_dbsm: Option<f32>,
}

/// A detection with all that a radar may tell of it.
#[derive(Serialize)]
pub(super) struct DetectionInSpaceRow {
    #[serde(rename = "time_us")]
    pub time_us: i64,
    #[serde(rename = "sensor")]
    pub sensor: usize,
    #[serde(rename = "range_m")]
    pub range_m: Option<f32>,
    #[serde(rename = "azimuth_rad")]
    pub azimuth_rad: Option<f32>,
    #[serde(rename = "radial_speed_mps")]
    pub radial_speed_mps: Option<f32>,
    #[serde(rename = "rcs_dbsm")]
    pub rcs_dbsm: Option<f32>,
    #[serde(rename = "elevation_rad")]
    pub elevation_rad: Option<f32>,
    #[serde(rename = "detection_time_offset_us")]
    pub detection_time_offset_us: Option<i32>,
}

#[derive(Serialize)]
pub(super) struct OdometryRow {
    #[serde(rename = "time_us")]
    pub time_us: i64,
    #[serde(rename = "x_m")]
    pub x_m: f64,
    #[serde(rename = "y_m")]
    pub y_m: f64,
    #[serde(rename = "yaw_rad")]
    pub yaw_rad: f64,
}

impl OdometryRow {
    pub(super) fn new(time_us: i64, Pose2 { x_m, y_m, yaw_rad }: Pose2) -> Self {
        Self { time_us, x_m, y_m, yaw_rad }
    }
}

#[derive(Serialize)]
pub(super) struct GeodeticRow {
    #[serde(rename = "time_us")]
    pub time_us: i64,
    #[serde(rename = "latitude_deg")]
    pub latitude_deg: f64,
    #[serde(rename = "longitude_deg")]
    pub longitude_deg: f64,
    #[serde(rename = "yaw_rad")]
    pub yaw_rad: f64,
    #[serde(rename = "sigma_position_m")]
    pub sigma_position_m: f64,
    #[serde(rename = "sigma_yaw_rad")]
    pub sigma_yaw_rad: f64,
}

impl From<&GeoPose> for GeodeticRow {
    fn from(pose: &GeoPose) -> Self {
        Self {
            time_us: pose.time_us,
            latitude_deg: pose.at.lat_deg,
            longitude_deg: pose.at.lon_deg,
            yaw_rad: pose.yaw_rad,
            sigma_position_m: pose.sigma_position_m,
            sigma_yaw_rad: pose.sigma_yaw_rad,
        }
    }
}

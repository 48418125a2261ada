//! The rows of each file.

use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::pose::Pose2;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
pub(super) struct VehicleRow {
    pub vehicle: String,
}

#[derive(Serialize, Deserialize)]
pub(super) struct SensorRow {
    #[serde(rename = "sensor")]
    pub index: usize,
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_rad: f64,
}

#[derive(Serialize, Deserialize)]
pub(super) struct DetectionRow {
    pub time_us: i64,
    pub sensor: usize,
    pub range_m: Option<f32>,
    pub azimuth_rad: Option<f32>,
    #[serde(default)]
    pub radial_speed_mps: Option<f32>,
    #[serde(default)]
    pub rcs_dbsm: Option<f32>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct OdometryRow {
    pub time_us: i64,
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_rad: f64,
}

impl OdometryRow {
    pub(super) fn new(time_us: i64, Pose2 { x_m, y_m, yaw_rad }: Pose2) -> Self {
        Self { time_us, x_m, y_m, yaw_rad }
    }

    pub(super) fn pose(&self) -> Pose2 {
        Pose2::new(self.x_m, self.y_m, self.yaw_rad)
    }
}

#[derive(Serialize, Deserialize)]
pub(super) struct GeodeticRow {
    pub time_us: i64,
    pub latitude_deg: f64,
    pub longitude_deg: f64,
    pub yaw_rad: f64,
    pub sigma_position_m: f64,
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

impl From<&GeodeticRow> for GeoPose {
    fn from(row: &GeodeticRow) -> Self {
        Self {
            time_us: row.time_us,
            at: LatLon { lat_deg: row.latitude_deg, lon_deg: row.longitude_deg },
            yaw_rad: row.yaw_rad,
            sigma_position_m: row.sigma_position_m,
            sigma_yaw_rad: row.sigma_yaw_rad,
        }
    }
}

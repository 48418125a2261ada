//! A drive as a folder of CSV files.
//!
//! Every file has a header line; numbers are plain decimals; times are microseconds since the Unix
//! epoch (UTC); angles are radians counter-clockwise, headings from true east. Each file may be gzipped instead, with `.gz`
//! added to its name. Columns may come in any order, and columns not named here are ignored.
//!
//! | file | columns | |
//! |---|---|---|
//! | `drive.csv` | `vehicle` | optional: one row; without it the folder names the vehicle |
//! | `sensors.csv` | `sensor,x_m,y_m,yaw_rad` | the radars, counted from 0, on the body (x forward, y left) |
//! | `scans.csv` | `time_us,sensor,range_m,azimuth_rad,radial_speed_mps,rcs_dbsm,elevation_rad,detection_time_offset_us` | one row a detection |
//! | `odometry.csv` | `time_us,x_m,y_m,yaw_rad` | poses of the body in a frame of its own |
//! | `reference.csv` | `time_us,latitude_deg,longitude_deg,yaw_rad,sigma_position_m,sigma_yaw_rad` | optional |
//! | `truth.csv` | the same | optional |
//!
//! Times that are dates in seconds, milliseconds or nanoseconds are recognised by their size and told; a column `time_s`,
//! `time_ms` or `time_ns` instead of `time_us` states them. A row that cannot be used is skipped and told.
//!
//! Rows of `scans.csv` with the same time and sensor are one scan.
//! `radial_speed_mps` (positive away from the sensor), `rcs_dbsm`, `elevation_rad` (positive up) and
//! `detection_time_offset_us` (from `time_us`, of a radar that takes its time for a scan) may be missing as columns, or
//! empty (or NaN) in all rows of a scan; the last two are written where some scan has them. A row without range and azimuth is a scan that detected nothing.

mod bounded;
mod cells;
mod read;
mod row;
mod scans;
mod table;
mod write;

pub(super) use read::read;
pub(crate) use table::Table;
pub(super) use write::write;

const SENSORS: [&str; 4] = ["sensor", "x_m", "y_m", "yaw_rad"];
const SCANS: [&str; 6] = ["time_us", "sensor", "range_m", "azimuth_rad", "radial_speed_mps", "rcs_dbsm"];
/// The columns of scans of which some have elevations or times of their detections.
const SCANS_IN_SPACE: [&str; 8] = [
    "time_us",
    "sensor",
    "range_m",
    "azimuth_rad",
    "radial_speed_mps",
    "rcs_dbsm",
    "elevation_rad",
    "detection_time_offset_us",
];
const ODOMETRY: [&str; 4] = ["time_us", "x_m", "y_m", "yaw_rad"];
const GEODETIC: [&str; 6] =
    ["time_us", "latitude_deg", "longitude_deg", "yaw_rad", "sigma_position_m", "sigma_yaw_rad"];

//! What may be wrong with a row or a message.

use echofix_core::{odometry, scan};

/// What is wrong with a row of a table, or with a message of an MCAP file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// A table lacks a column.
    #[error("column `{column}` is missing; expected {expected}")]
    MissingColumn {
        /// The column.
        column: String,
        /// All columns that are required, with commas between.
        expected: String,
    },
    /// A row has more or fewer fields than the header.
    #[error("it has {found} fields, the header {expected}")]
    FieldCount {
        /// Fields of the row.
        found: u64,
        /// Fields of the header.
        expected: u64,
    },
    /// A row cannot be parsed.
    #[error("{0}")]
    Unparsable(String),
    /// A message is not of the type its topic has.
    #[error("it does not decode: {0}")]
    Undecodable(#[from] prost::DecodeError),
    /// Sensors are not numbered in order.
    #[error("expected sensor {expected}; sensors count from 0, one row each")]
    SensorOrder {
        /// The sensor whose row was expected.
        expected: usize,
    },
    /// A scan names a sensor that the drive does not have.
    #[error("sensor {sensor} is not in sensors.csv, which has {sensors}")]
    UnknownSensor {
        /// The sensor named.
        sensor: usize,
        /// Sensors there are.
        sensors: usize,
    },
    /// A detection has a range or an azimuth, but not both.
    #[error("range_m and azimuth_rad must both be given, or both be empty in a scan's only row")]
    HalfADetection,
    /// Some rows of a scan have a value that others lack.
    #[error("{column} must be given in all rows of a scan or in none")]
    PartialColumn {
        /// The column.
        column: &'static str,
    },
    /// A range is negative.
    #[error("range_m is {range_m}; ranges are distances from the sensor")]
    NegativeRange {
        /// The range given.
        range_m: f32,
    },
    /// A value is NaN or infinite.
    #[error("a value is not a finite number; leave such rows out")]
    NotFinite,
    /// Not a position on the globe.
    #[error("{lat_deg}, {lon_deg} is not a position in degrees")]
    NotAPosition {
        /// Degrees north.
        lat_deg: f64,
        /// Degrees east.
        lon_deg: f64,
    },
    /// A time that microseconds cannot hold.
    #[error("{seconds} is not a time in seconds")]
    NotATime {
        /// The number given.
        seconds: f64,
    },
    /// A scan's columns cannot be used.
    #[error(transparent)]
    Scan(#[from] scan::Error),
    /// An odometry pose cannot be used.
    #[error(transparent)]
    Odometry(#[from] odometry::Error),
}

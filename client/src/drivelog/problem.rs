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
    /// A value of a row cannot be parsed.
    #[error("column `{column}` is `{value}`: {problem}")]
    Value {
        /// The column.
        column: String,
        /// What stands there.
        value: String,
        /// Why that is no value.
        problem: String,
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
    /// A sensor has two places.
    #[error("sensor {sensor} stands there twice, with different values; keep the one that is right")]
    TwoMounts {
        /// The sensor.
        sensor: usize,
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
    /// An elevation beyond straight up or down.
    #[error("elevation_rad is {elevation_rad}; elevations are radians, positive up, at most a right angle")]
    NoElevation {
        /// The elevation given.
        elevation_rad: f32,
    },
    /// A standard deviation is negative.
    #[error("{column} is {value}; a standard deviation is not negative")]
    NegativeSigma {
        /// The column.
        column: &'static str,
        /// The value given.
        value: f64,
    },
    /// The same record is there already.
    #[error("the same record stands before it, or another of the same time")]
    Doubled,
    /// A time that does not fit those around it.
    #[error(
        "its time {time_us} us does not fit the records around it, the last of which is of {before_us} us"
    )]
    OutOfOrder {
        /// The time.
        time_us: i64,
        /// The time of the last record that fits.
        before_us: i64,
    },
    /// The file ends, or is damaged so that nothing behind can be read.
    #[error("the file is cut off or damaged here ({0}); what comes before was read")]
    CutOff(String),
    /// A part of a file fails its checksum or cannot be unpacked.
    #[error("a chunk of {bytes} bytes is damaged ({problem}); the others were read")]
    DamagedChunk {
        /// Bytes of the chunk in the file.
        bytes: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// A message that is too large to be what its topic says.
    #[error("it takes {bytes} bytes, which no such message does")]
    TooLarge {
        /// Bytes of the message.
        bytes: u64,
    },
    /// A pose that no vehicle can have between those before and after it.
    #[error("it lies elsewhere than the poses around it, farther than anybody drives in that time")]
    Elsewhere,
    /// Not a position on the globe.
    #[error("latitude {lat_deg}, longitude {lon_deg} is not a position in degrees")]
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

impl Problem {
    /// The kind of problem as one word, the same in every version: `unreadable`, `not_finite`, `out_of_range`, `incomplete`,
    /// `doubled`, `out_of_order`, `elsewhere`, `unknown_sensor`, `cut_off` or `damaged`.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::MissingColumn { .. }
            | Self::FieldCount { .. }
            | Self::Value { .. }
            | Self::Unparsable(_)
            | Self::Undecodable(_)
            | Self::SensorOrder { .. }
            | Self::TwoMounts { .. }
            | Self::TooLarge { .. } => "unreadable",
            Self::UnknownSensor { .. } => "unknown_sensor",
            Self::HalfADetection | Self::PartialColumn { .. } => "incomplete",
            Self::NotFinite => "not_finite",
            Self::Scan(error) => error.reason(),
            Self::Odometry(error) => error.reason(),
            Self::NegativeRange { .. }
            | Self::NoElevation { .. }
            | Self::NegativeSigma { .. }
            | Self::NotAPosition { .. }
            | Self::NotATime { .. } => "out_of_range",
            Self::Doubled => "doubled",
            Self::OutOfOrder { .. } => "out_of_order",
            Self::Elsewhere => "elsewhere",
            Self::CutOff(_) => "cut_off",
            Self::DamagedChunk { .. } => "damaged",
        }
    }
}

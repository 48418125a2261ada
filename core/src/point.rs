//! Points, with the frame they are given in: one of another frame does not compile.
//!
//! - [`MapPoint`]: on the map. [`BodyPoint`]: in the body's frame. [`SensorPoint`]: in a radar's.
//! - [`WeightedPoint`]: one of a thinned batch, with its vote.
//!
//! A [`BodyPoint`] comes onto the map by [`Pose2::to_map`](crate::pose::Pose2::to_map). Geometry that holds in any frame, such as
//! [`Pose2::transform`](crate::pose::Pose2::transform), and numbers within a computation are plain arrays.

/// A position on the map: UTM metres of the zone at hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapPoint {
    /// Metres east: the easting.
    pub x_m: f64,
    /// Metres north: the northing.
    pub y_m: f64,
}

impl MapPoint {
    /// A position from its easting and northing.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64) -> Self {
        Self { x_m, y_m }
    }

    /// The position so many metres farther east and north.
    #[must_use]
    pub fn moved(self, east_m: f64, north_m: f64) -> Self {
        Self::new(self.x_m + east_m, self.y_m + north_m)
    }

    /// Distance to another position, map metres.
    #[must_use]
    pub fn distance_m(self, other: Self) -> f64 {
        (self.x_m - other.x_m).hypot(self.y_m - other.y_m)
    }
}

/// From easting and northing, where these come in as an array.
impl From<[f64; 2]> for MapPoint {
    fn from([x_m, y_m]: [f64; 2]) -> Self {
        Self::new(x_m, y_m)
    }
}

/// Easting and northing, where an array is asked for.
impl From<MapPoint> for [f64; 2] {
    fn from(point: MapPoint) -> Self {
        [point.x_m, point.y_m]
    }
}

/// A position in the body's frame, be it where a batch puts the body or where a computation thinks one: ground
/// metres, single precision.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct BodyPoint {
    /// Metres forward.
    pub x_m: f32,
    /// Metres left.
    pub y_m: f32,
}

impl BodyPoint {
    /// A position from metres forward and left.
    #[must_use]
    pub const fn new(x_m: f32, y_m: f32) -> Self {
        Self { x_m, y_m }
    }

    /// Its squared distance from the body, square metres.
    #[must_use]
    #[inline]
    pub fn squared_range(&self) -> f32 {
        self.x_m * self.x_m + self.y_m * self.y_m
    }
}

/// A position in a radar's frame: ground metres, single precision.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct SensorPoint {
    /// Metres along the boresight.
    pub x_m: f32,
    /// Metres left of it.
    pub y_m: f32,
}

/// A point of a thinned batch: ground metres in the body's frame, and what it counts for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct WeightedPoint {
    /// Metres forward.
    pub x_m: f32,
    /// Metres left.
    pub y_m: f32,
    /// Its vote.
    pub vote: f32,
}

impl WeightedPoint {
    /// A point from metres forward and left, and its vote.
    #[must_use]
    pub const fn new(x_m: f32, y_m: f32, vote: f32) -> Self {
        Self { x_m, y_m, vote }
    }

    /// Where it lies.
    #[must_use]
    #[inline]
    pub const fn position(&self) -> BodyPoint {
        BodyPoint::new(self.x_m, self.y_m)
    }
}

//! What kind of town is laid out.

use echofix_core::geo::LatLon;

use crate::error::{Error, within};

/// What kind of town is laid out. The same parameters give the same town.
#[derive(Debug, Clone, PartialEq)]
pub struct CityParams {
    /// Seed of everything in the town, parked cars and traffic included.
    pub seed: u64,
    /// Centre of the town.
    pub origin: LatLon,
    /// Blocks from west to east.
    pub blocks_x: usize,
    /// Blocks from south to north.
    pub blocks_y: usize,
    /// Distance of the north-south streets' centre lines, metres.
    pub block_w_m: f64,
    /// Distance of the east-west streets' centre lines, metres.
    pub block_h_m: f64,
    /// How far intersections lie from a regular grid at most, metres along each axis.
    pub irregularity_m: f64,
    /// Turn of the whole grid of streets, radians counter-clockwise.
    pub rotation_rad: f64,
    /// Fraction of the parking slots taken on any day.
    pub parking_occupancy: f64,
    /// Moving vehicles per kilometre of street and direction.
    pub traffic_per_km: f64,
}

impl Default for CityParams {
    /// Nine blocks of downtown Austin's size and orientation: 2.5 km of streets.
    fn default() -> Self {
        Self {
            seed: 1,
            origin: LatLon { lat_deg: 30.2672, lon_deg: -97.7431 },
            blocks_x: 3,
            blocks_y: 3,
            block_w_m: 120.0,
            block_h_m: 90.0,
            irregularity_m: 6.0,
            rotation_rad: -0.32,
            parking_occupancy: 0.65,
            traffic_per_km: 6.0,
        }
    }
}

impl CityParams {
    /// Checks that blocks leave room for streets, turns and buildings.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), Error> {
        let count = (1.0, 100.0);
        within("blocks_x", self.blocks_x as f64, count, "from 1 to 100")?;
        within("blocks_y", self.blocks_y as f64, count, "from 1 to 100")?;
        within("block_w_m", self.block_w_m, (70.0, 500.0), "from 70 to 500 m")?;
        within("block_h_m", self.block_h_m, (70.0, 500.0), "from 70 to 500 m")?;
        within("irregularity_m", self.irregularity_m, (0.0, 8.0), "from 0 to 8 m")?;
        within("rotation_rad", self.rotation_rad, (-10.0, 10.0), "an angle in radians")?;
        within("parking_occupancy", self.parking_occupancy, (0.0, 1.0), "from 0 to 1")?;
        within("traffic_per_km", self.traffic_per_km, (0.0, 100.0), "from 0 to 100 per km")
    }
}

//! WGS-84 to UTM and back, and the tiles of the plane.
//!
//! UTM is conformal but not metric-true: a sensor metre is [`Grid::scale_factor`] map metres, and
//! grid north differs from true north by the meridian convergence. Headings on the wire are
//! counter-clockwise from true east, yaw inside this crate counter-clockwise from grid east;
//! [`Grid`] converts. The projection itself is the `geodesy` crate's (Poder/Engsager).
//!
//! Near a zone border the map is held in both zones ([`zones_near`]), so that an upload or a
//! request sees one map whichever side it comes from.

mod distance;
mod grid;
mod routing;
mod tile_id;
mod zone;

pub use distance::{MetresPerDegree, ground_distance_m};
pub use grid::{Grid, LatLon};
pub use routing::RoutingRegion;
pub use tile_id::{CELL_M, CELLS_PER_TILE, CellIndex, TILE_M, TileId};
pub use zone::{Zone, zones_near};

/// Why a position cannot be projected, or a zone or tile is none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Not a position on the globe.
    #[error(
        "latitude {lat_deg}, longitude {lon_deg} is not a position in degrees; are latitude and longitude exchanged?"
    )]
    NotAPosition {
        /// Degrees north, as given.
        lat_deg: f64,
        /// Degrees east, as given.
        lon_deg: f64,
    },
    /// UTM ends near the poles.
    #[error(
        "latitude {lat_deg} lies outside UTM, which covers 80 degrees south to 84 degrees north; are latitude and longitude exchanged?"
    )]
    OutsideUtm {
        /// Degrees north, as given.
        lat_deg: f64,
    },
    /// The projection library refused the operation.
    #[error("UTM zone {epsg} cannot be set up: {reason}")]
    Projection {
        /// EPSG code of the zone.
        epsg: u16,
        /// What the projection library reports.
        reason: String,
    },
    /// An EPSG code that is not WGS-84 / UTM.
    #[error("EPSG:{epsg} is not a WGS-84 UTM zone; expected 32601-32660 or 32701-32760")]
    NotUtm {
        /// The code that is no UTM zone.
        epsg: u32,
    },
    /// A tile id that cannot be read.
    #[error("`{text}` is not a tile id; expected EPSG/x/y, for instance 32614/12131/65407")]
    NotATileId {
        /// The text that is no tile id.
        text: String,
    },
}

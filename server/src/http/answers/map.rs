//! The map and its tiles in numbers.

use serde::Serialize;
use utoipa::ToSchema;

/// How far the map is.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Progress)]
pub struct ProgressAnswer {
    /// Whether the map can be read: `serving`, `rebuilding` or `stalled`.
    #[schema(pattern = "^(serving|rebuilding|stalled)$", example = "serving")]
    pub state: &'static str,
    /// Number of the last record of the journal folded into the map.
    pub epoch: u64,
    /// Number of the last record in the journal.
    pub journaled: u64,
    /// A new generation of the map that is being made; what is served meanwhile does not show its control yet.
    #[schema(required)]
    pub building: Option<BuildingAnswer>,
}

/// A new generation of the map that is being made.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Building)]
pub struct BuildingAnswer {
    /// The last record folded into it.
    pub folded: u64,
    /// Number of the last record in the journal.
    pub of: u64,
    /// Number of the control it is made under; 0 when it replaces lost tiles.
    pub control: u64,
}

/// The whole map in numbers.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Map)]
pub struct MapAnswer {
    /// How far it is.
    #[serde(flatten)]
    pub progress: ProgressAnswer,
    /// What it holds.
    pub totals: TotalsAnswer,
    /// What of it is not served yet.
    pub waiting: WaitingAnswer,
    /// The UTM zones that it lies in.
    pub zones: Vec<ZoneAnswer>,
    /// West, south, east, north in degrees, west the larger one across the date line; null for an empty map.
    #[schema(required, min_items = 4, max_items = 4)]
    pub bounds: Option<[f64; 4]>,
    /// Longitude and latitude of the densest part, degrees; null for an empty map.
    #[schema(required, min_items = 2, max_items = 2)]
    pub center: Option<[f64; 2]>,
}

/// What the map holds.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Totals)]
pub struct TotalsAnswer {
    /// Tiles of 51.2 m.
    pub tiles: u64,
    /// Occupied cells of 10 cm.
    pub cells: u64,
    /// Bytes of encoded tiles.
    pub bytes: u64,
    /// Uploads counted since the journal began.
    pub uploads: u64,
    /// Area of the tiles, square kilometres.
    pub area_km2: f64,
    /// Last UTC day anything was seen, counted from the Unix epoch.
    pub newest_day: u16,
    /// The same as a date; null for an empty map.
    #[schema(required, format = Date)]
    pub newest_date: Option<String>,
}

/// Tiles of which nothing is served yet, because too few contributors have seen the same there.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Waiting)]
pub struct WaitingAnswer {
    /// How many of `totals.tiles`.
    pub tiles: u64,
    /// The most contributors that have seen the same in one of them.
    pub contributors: u8,
    /// Contributors that are needed (`mapping.publish_contributors`).
    pub needed: u8,
}

/// A UTM zone of the map.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = ZoneTiles)]
pub struct ZoneAnswer {
    /// EPSG code.
    pub epsg: u16,
    /// The zone in words.
    #[schema(example = "UTM 14 north")]
    pub name: String,
    /// Tiles in it.
    pub tiles: u64,
}

/// One tile in numbers.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Tile)]
pub struct TileAnswer {
    /// EPSG code/x/y.
    #[schema(example = "32614/12127/65410")]
    pub id: String,
    /// EPSG code of the zone.
    pub epsg: u16,
    /// Tiles of 51.2 m east.
    pub x: i32,
    /// Tiles of 51.2 m north.
    pub y: i32,
    /// Epoch of its last change.
    pub version: u64,
    /// Occupied cells.
    pub cells: usize,
    /// Detections.
    pub hits: u64,
    /// How many cells so many passes stand behind.
    pub passes: Vec<PassCount>,
    /// First UTC date anything was seen.
    #[schema(required, format = Date)]
    pub oldest_date: Option<String>,
    /// Last UTC day anything was seen, counted from the Unix epoch.
    pub newest_day: u16,
    /// The same as a date.
    #[schema(required, format = Date)]
    pub newest_date: Option<String>,
    /// Encoded size, bytes.
    pub bytes: usize,
    /// South-west, south-east, north-east, north-west as longitude and latitude, degrees.
    pub corners: [[f64; 2]; 4],
}

/// How many cells so many passes stand behind.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct PassCount {
    /// Passes.
    pub passes: u32,
    /// Cells.
    pub cells: u32,
}

/// What fixes in a tile can be expected to be, by the map alone.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Localizability)]
pub struct LocalizabilityAnswer {
    /// EPSG code/x/y.
    pub id: String,
    /// Newest version of the tiles that this rests on.
    pub version: u64,
    /// Four spots, row by row from the south-west; each stands for a quarter of the tile.
    pub places: Vec<ExpectedFixAnswer>,
}

/// What a fix at a spot can be expected to be.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = ExpectedFix)]
pub struct ExpectedFixAnswer {
    /// Degrees east.
    pub longitude_deg: f64,
    /// Degrees north.
    pub latitude_deg: f64,
    /// The status that a fix will most likely get: `USABLE`, `AMBIGUOUS` or `TOO_LITTLE_STRUCTURE`.
    #[schema(example = "USABLE")]
    pub expected: &'static str,
    /// Points on mapped structure that a thinned batch can be expected to have.
    pub points: usize,
    /// One sigma along the weakest axis, metres, the map's own error included.
    pub weakest_sigma_m: f64,
    /// Direction of that axis, radians counter-clockwise from true east, in (-pi / 2, pi / 2].
    pub weakest_direction_rad: f64,
    /// One sigma across it, metres.
    pub strongest_sigma_m: f64,
    /// One sigma of the heading, radians.
    pub sigma_yaw_rad: f64,
    /// Log-likelihood by which the spot exceeds the most similar one within 6 m, nats; null without one.
    #[schema(required)]
    pub margin: Option<f64>,
    /// Where that one is, metres east and north on the grid.
    #[schema(required, min_items = 2, max_items = 2)]
    pub rival_m: Option<[f64; 2]>,
}

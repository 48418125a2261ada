//! Tiles to the cell.

use serde::Serialize;
use utoipa::ToSchema;

/// What is known of a cell.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Cell)]
pub struct CellAnswer {
    /// Row-major index in the tile, from the south-west corner.
    pub index: u32,
    /// Cells of 10 cm east of the tile's corner.
    pub column: u32,
    /// Cells of 10 cm north of it.
    pub row: u32,
    /// Its middle, degrees north.
    pub latitude_deg: f64,
    /// Its middle, degrees east.
    pub longitude_deg: f64,
    /// Detections in it.
    pub hits: u32,
    /// Passes that hit it.
    pub passes: u32,
    /// Passes that had its surroundings in view.
    pub observed: u16,
    /// Distinct contributors that hit it, 255 for all above.
    pub contributors: u8,
    /// Distinct contributors that hit something within the same 0.4 m.
    pub support: u8,
    /// Of the passes with it in view, the part that hit it lately.
    pub presence: f64,
    /// First UTC date it was hit.
    #[schema(format = Date)]
    pub first_date: String,
    /// Last UTC date it was hit.
    #[schema(format = Date)]
    pub last_date: String,
    /// Whether it is served: `SERVED`, or the first reason why not: `TOO_FEW_CONTRIBUTORS`, `HIT_BY_TOO_FEW`, `EXPIRED` or
    /// `FADED`.
    #[schema(pattern = "^(SERVED|TOO_FEW_CONTRIBUTORS|HIT_BY_TOO_FEW|EXPIRED|FADED)$", example = "SERVED")]
    pub standing: &'static str,
    /// The standing in words.
    pub reason: String,
    /// Keyed hashes of the contributors whose passes of the last days hit it; older passes are only counted. For operators, where
    /// one cell is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contributor_hashes: Option<Vec<String>>,
}

/// The cells of a tile.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = TileCells)]
pub struct CellsAnswer {
    /// EPSG code/x/y.
    #[schema(example = "32614/12127/65410")]
    pub tile: String,
    /// Epoch of the tile's last change.
    pub version: u64,
    /// Contributors that are needed for a cell to be served (`mapping.publish_contributors`).
    pub needed: u8,
    /// In order of their indexes.
    pub cells: Vec<CellAnswer>,
    /// The index after which the next ones are asked for; absent with the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_after: Option<u32>,
}

/// The cell at a position.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = CellAt)]
pub struct CellAtAnswer {
    /// The tile that holds the position: EPSG code/x/y.
    #[schema(example = "32614/12127/65410")]
    pub tile: String,
    /// Epoch of the tile's last change.
    pub version: u64,
    /// Contributors that are needed for a cell to be served (`mapping.publish_contributors`).
    pub needed: u8,
    /// How far the cell's middle is from the position, metres; null without a cell.
    #[schema(required)]
    pub distance_m: Option<f64>,
    /// The cell; null where none of the tile's lies near enough.
    #[schema(required)]
    pub cell: Option<CellAnswer>,
}

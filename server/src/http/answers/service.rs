//! How the service is, who asks, the feeds, a layer, an error.

use serde::Serialize;
use utoipa::ToSchema;

use crate::feed::{FixEvent, MapOffset, Place, QuarantineEvent, UploadEvent};
use crate::http::raster::LegendEntry;

/// Why a request was not answered.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Error)]
pub struct ErrorAnswer {
    /// The reason.
    pub error: ErrorBody,
}

/// The reason why a request was not answered.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ErrorReason)]
pub struct ErrorBody {
    /// A word for programs.
    #[schema(example = "not_found")]
    pub code: &'static str,
    /// A sentence for people.
    pub message: String,
}

/// Whether the process is alive.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Alive)]
pub struct AliveAnswer {
    /// False when only a restart helps.
    pub alive: bool,
    /// What hangs.
    #[schema(required)]
    pub reason: Option<String>,
}

/// Whether requests are welcome.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Readiness)]
pub struct ReadinessAnswer {
    /// Whether vehicles can be localized.
    pub ready: bool,
    /// What is not well.
    #[schema(required)]
    pub reason: Option<String>,
    /// Whether vehicles can be localized.
    pub localizing: PartReadiness,
    /// Whether uploads are taken.
    pub uploading: PartReadiness,
    /// Epoch of the map that is served.
    pub epoch: u64,
    /// The newest epoch: uploads up to it are on disk.
    pub journaled: u64,
}

/// Whether requests of a kind are welcome.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct PartReadiness {
    /// Whether they are.
    pub ready: bool,
    /// What is not well; why not, if not ready.
    #[schema(required)]
    pub reason: Option<String>,
}

/// Whether requests are welcome, and from whom.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Ready)]
pub struct ReadyAnswer {
    /// Whether they are.
    #[serde(flatten)]
    pub readiness: ReadinessAnswer,
    /// The roles that anybody has who reaches the ports, where the configuration gives any.
    #[schema(required)]
    pub anonymous: Option<String>,
}

/// The map of streets that the console shows below the radar map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = BaseMap)]
pub struct BaseMapAnswer {
    /// `NONE`, `TILES` of another service, or a `PMTILES` file of this one.
    #[schema(pattern = "^(NONE|TILES|PMTILES)$", example = "TILES")]
    pub kind: &'static str,
    /// The template of the tiles' addresses, or where the file is, relative to the console; null where there is none.
    #[schema(required, example = "https://tiles.example/{z}/{x}/{y}.png")]
    pub url: Option<String>,
    /// Whose map it is, in words, as its licence asks.
    pub attribution: String,
    /// The last zoom that the tiles have; a `PMTiles` file says so itself.
    pub max_zoom: u8,
}

/// Who asks.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Caller)]
pub struct CallerAnswer {
    /// The name by which the caller is known; empty for nobody in particular.
    pub name: String,
    /// What the caller may do: `vehicle`, `mapper`, `gateway`, `viewer`, `operator`, `admin`, `replica`.
    pub roles: Vec<&'static str>,
    /// How both are known: `unasked`, `anonymous`, `certificate`, `token`, `jwt`, `oidc`, `proxy`.
    #[schema(example = "token")]
    pub known_by: &'static str,
    /// In a session: what its page must send as `x-echofix-csrf` with each change.
    #[schema(required)]
    pub csrf: Option<String>,
}

/// By which ways a browser may sign in.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SignInWays)]
pub struct SignInWaysAnswer {
    /// With a token, by `POST /session`.
    pub token: bool,
    /// At an issuer, by `GET /session/oidc`.
    pub oidc: bool,
}

/// `TileJSON` 3.0 of a layer.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TileJson)]
pub struct TileJsonAnswer {
    /// The version of `TileJSON`.
    #[schema(example = "3.0.0")]
    pub tilejson: &'static str,
    /// The layer's name.
    pub name: String,
    /// What it shows.
    pub description: &'static str,
    /// `1.0.EPOCH`
    pub version: String,
    /// How tiles are numbered.
    #[schema(example = "xyz")]
    pub scheme: &'static str,
    /// Addresses of the pictures, with `{z}`, `{x}` and `{y}`.
    pub tiles: [String; 1],
    /// 0, or the first zoom that shows the layer.
    pub minzoom: u8,
    /// The last zoom.
    pub maxzoom: u8,
    /// West, south, east, north, degrees.
    #[schema(min_items = 4, max_items = 4)]
    pub bounds: [f64; 4],
    /// Longitude and latitude in degrees, and zoom; null for an empty map.
    #[schema(required, value_type = Option<[f64; 3]>, min_items = 3, max_items = 3)]
    pub center: Option<(f64, f64, u8)>,
    /// Whose the map is.
    pub attribution: &'static str,
    /// Empty: the tiles are pictures.
    #[schema(value_type = Vec<Object>)]
    pub vector_layers: [(); 0],
    /// What the colours stand for.
    pub legend: Vec<LegendEntry>,
}

/// The last fixes.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Fixes)]
pub struct FixesAnswer {
    /// Newest first.
    pub fixes: Vec<FixEvent>,
}

/// The last uploads.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Uploads)]
pub struct UploadsAnswer {
    /// Newest first.
    pub uploads: Vec<UploadEvent>,
}

/// Events that a listener cannot be told.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Missed)]
pub struct MissedEvent {
    /// How many, where that is known.
    #[schema(required)]
    pub count: Option<u64>,
    /// `TOO_OLD`: they are no longer kept; `OTHER_RUN`: the id is of another run of the service.
    #[schema(example = "TOO_OLD")]
    pub reason: &'static str,
}

/// What vetting kept out of the map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Quarantine)]
pub struct QuarantineAnswer {
    /// How many uploads.
    pub quarantined: usize,
    /// Newest first; the newest 10 000 of them.
    pub uploads: Vec<QuarantineEvent>,
    /// Where several contributors agree with each other, but not with the map.
    pub alarms: Vec<AlarmAnswer>,
}

/// Several contributors agree with each other, but not with the map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Alarm)]
pub struct AlarmAnswer {
    /// `SHIFT`: they lie beside the map alike; `CHANGED`: they show something else.
    #[schema(example = "SHIFT")]
    pub kind: &'static str,
    /// What would move them onto the map; null when they show something else.
    #[schema(required)]
    pub offset: Option<MapOffset>,
    /// Distinct contributors.
    pub contributors: usize,
    /// UTC date of the first of the uploads.
    #[schema(format = Date)]
    pub since: String,
    /// The middle of the uploads, for viewers to a hundredth of a degree; null where the zone does not reach.
    #[schema(required)]
    pub place: Option<Place>,
}

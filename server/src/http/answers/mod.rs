//! What the operators' port answers in JSON, as types. The `OpenAPI` document is made from them.
//!
//! - `map`: the map and its tiles in numbers.
//! - `cells`: a tile to the cell.
//! - `contributors`: who contributed, and what.
//! - `history`: what happened to the map, how two maps differ, what was decided.
//! - `service`: how the service is, who asks, the feeds, a layer, an error.

mod cells;
mod contributors;
mod history;
mod map;
mod service;

pub use cells::{CellAnswer, CellAtAnswer, CellsAnswer};
pub use contributors::{
    ContributedUploadAnswer, ContributorAnswer, ContributorUploadsAnswer, ContributorsAnswer,
    KnownUploadAnswer, RevocationAnswer,
};
pub use history::{
    Cells, DecidedAnswer, DiffAnswer, DifferenceAnswer, EventAnswer, Happened, HistoryAnswer, ImportedAnswer,
    PreviewAnswer, RemarkedAnswer, TakenAndGiven, TileDifference, VerifiedAnswer,
};
pub use map::{
    BuildingAnswer, ExpectedFixAnswer, LocalizabilityAnswer, MapAnswer, PassCount, ProgressAnswer,
    TileAnswer, TotalsAnswer, WaitingAnswer, ZoneAnswer,
};
pub use service::{
    AlarmAnswer, AliveAnswer, BaseMapAnswer, CallerAnswer, ErrorAnswer, ErrorBody, FixesAnswer, MissedEvent,
    PartReadiness, QuarantineAnswer, ReadinessAnswer, ReadyAnswer, SignInWaysAnswer, TileJsonAnswer,
    UploadsAnswer,
};

/// Why a request is refused that may be sent again in a second.
pub const BUSY: &str = "All permits of this kind are taken, or the map is being rebuilt; `Retry-After` says when to \
    ask again.";
/// What a decision is answered with.
pub const DECIDED: &str =
    "It is on disk; the map shows it from its epoch on. Of a dry run: what it would change.";
/// Why a body is refused.
pub const MALFORMED: &str = "Not what is asked for.";
/// Why a look at the past is refused.
pub const NO_SUCH_EPOCH: &str = "An epoch that is compacted or has not come yet.";

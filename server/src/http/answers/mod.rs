//! What the operators' port answers in JSON, as types. The `OpenAPI` document is made from them.
//!
//! - `map`: the map and its tiles in numbers.
//! - `history`: what happened to the map, how two maps differ, what was decided.
//! - `service`: how the service is, who asks, the feeds, a layer, an error.

mod history;
mod map;
mod service;

pub use history::{
    Cells, DecidedAnswer, DiffAnswer, DifferenceAnswer, EventAnswer, Happened, HistoryAnswer, ImportedAnswer,
    PreviewAnswer, RemarkedAnswer, TakenAndGiven, TileDifference, VerifiedAnswer,
};
pub use map::{
    BuildingAnswer, ExpectedFixAnswer, LocalizabilityAnswer, MapAnswer, PassCount, ProgressAnswer,
    TileAnswer, TotalsAnswer, WaitingAnswer, ZoneAnswer,
};
pub use service::{
    AlarmAnswer, AliveAnswer, CallerAnswer, ErrorAnswer, ErrorBody, FixesAnswer, MissedEvent, PartReadiness,
    QuarantineAnswer, ReadinessAnswer, ReadyAnswer, TileJsonAnswer, UploadsAnswer,
};

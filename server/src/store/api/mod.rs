//! What every storage engine offers, and its values. It knows nothing of how anything is stored.

mod clock;
mod contributors;
mod decision;
mod error;
mod history;
mod map_store;
mod operations;
mod progress;
mod reports;
mod upcoming;
mod values;

pub use clock::StoreClock;
pub use contributors::{ContributedUpload, ContributorFigures, Revocation, UploadFate};
pub use decision::{Contributor, Decision, LONGEST_REMARK, Preview, Proposal, Remark};
pub use error::Error;
pub(in crate::store) use error::io_error;
pub use history::{EventKind, HistoryEvent, Snapshot, TileDiff};
pub use map_store::MapStore;
pub use operations::Operations;
pub use progress::{Building, MapProgress, MapStatus};
pub use reports::{FoldingFigures, Imported, QuarantinedRecord, Region, Verified};
pub use upcoming::{Preparing, UpcomingMap};
pub use values::{InspectedTile, Receipt, StoredTile, TileInfo, Totals, UploadRecord, Withheld};

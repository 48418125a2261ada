//! Contributing to the map: record, spool, send.
//!
//! 1. [`Recorder`] takes scans and reference poses as they come, retains what can be mapped (poses known well
//!    enough, scans fast and near enough, no movers), and splits the drive into [`PreparedUpload`]s: of the
//!    evidence built on the way, or of the scans themselves ([`UploadForm`]).
//! 2. [`Uploader::submit`] puts an upload on disk; once it returns, the upload survives crashes
//!    and power cuts of the vehicle.
//! 3. In the background the uploads are sent, oldest first, each until the service has
//!    acknowledged it; an id counts once however often it is sent. What the service refuses for
//!    good stays in the spool's `refused` folder with the reason.
//!
//! A [`Demand`] keeps what the service answered about the places that it knows well: a recorder that keeps to it sends of those
//! what is wanted, which is little.

mod config;
mod contents;
mod demand;
mod progress;
mod recorder;
mod segment;
mod sender;
pub mod spool;
mod uploader;

pub use config::{RecorderConfig, UploadForm};
pub use contents::{DamagedUpload, PreparedUpload};
pub use demand::Demand;
pub use progress::{UploadEvent, UploadProgress, UploaderOptions};
pub use recorder::{Error, FinishedTrip, Recorder};
pub use spool::Spool;
pub use uploader::{FlushError, Uploader};

//! What the end-to-end tests, the lab and the demo share, so that all of them drive, upload, ask and compare in one
//! way.
//!
//! - [`process`]: the service as a process of its own; [`http`]: what its operators' port answers.
//! - [`credentials`]: who a command is to a service, and whom it believes; [`profile`]: the same under a name.
//! - [`town`]: drives in a simulated town.
//! - [`recording`]: a drive becomes uploads, through the vehicle's own recorder; [`uploading`]: they go to the map,
//!   through the vehicle's spool and uploader.
//! - [`flaws`]: what of a drive cannot be used.
//! - [`truth`]: known poses and the error of an answer; [`prior`]: rough poses drawn around them.
//! - [`questions`]: what a drive asks; [`replay`]: asking it; [`fix_record`]: one question and its answer;
//!   [`summary`]: the figures of many.
//! - [`percentiles`]: nearest ranks, and the paper's figures to compare with; [`progress`]: bars for people; [`ranges`]:
//!   arguments that are numbers.

pub mod credentials;
pub mod fix_record;
pub mod flaws;
pub mod http;
pub mod percentiles;
pub mod prior;
pub mod process;
pub mod profile;
pub mod progress;
pub mod questions;
pub mod ranges;
pub mod recording;
pub mod replay;
pub mod summary;
pub mod town;
pub mod truth;
pub mod uploading;

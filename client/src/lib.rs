//! The vehicle's library: it records, uploads and localizes, and reads, writes and replays drive logs.
//!
//! The rooms, in reading order:
//!
//! - [`service`]: where the service is, and who the vehicle is to it.
//! - [`vehicle`]: localizing without any network: the sliding window of scans and odometry, the
//!   question to ask, the judgement of the answer, the fix carried on by odometry.
//! - [`filter`]: fixes and odometry fused to a smooth pose with an honest covariance.
//! - [`Localizer`]: sends the question, with a deadline and retries; [`LocalizationStream`]: the same over one stream, which
//!   carries only what is new.
//! - [`upload`]: contributing to the map: the recorder splits a drive into uploads, the spool holds them
//!   on disk, the uploader sends them until each is acknowledged.
//! - [`CoverageClient`]: where along a way the service has a map, and which uploads it wants.
//! - [`tiles`]: the map on the vehicle: a cache of tiles on disk that takes what changed.
//! - [`refusal`]: what a call came back with, typed.
//! - [`backoff`]: how long to wait before asking again.
//! - [`wire`]: from the values of [`echofix_core`] to the columns of the contract.
//! - [`drivelog`]: drives on disk, as MCAP or CSV, and their replay.
//! - `import`: public radar data as drives.
//!
//! Features, both on by default: `mcap` reads and writes drive logs as MCAP files; `csv` reads and writes them as
//! folders of CSV files, and has the imports. A vehicle needs neither: with `default-features = false` the
//! library takes no `mcap`, `csv` or `flate2`, and everything but reading and writing of logs is there.
//!
//! Conventions: a heading is radians, counter-clockwise from true east (0 is east, pi / 2 is north), of the body's forward
//! axis; an azimuth is radians, counter-clockwise from the radar's boresight, and a mount's yaw counter-clockwise from
//! forward: what is left is positive. A radial speed is metres per second, positive away from the radar, with the vehicle's own motion
//! still in it. Data in other conventions pass every check of ranges, so [`upload::Recorder::findings`] and
//! [`vehicle::Vehicle::findings`] look at whether they fit together, and ask. An elevation is radians, positive up; with it range and
//! radial speed are those of the slant, else those along the ground.
//!
//! How far detections count is one number, 50 m unless set: `gate.max_range_m` of [`upload::RecorderConfig`] and
//! [`vehicle::VehicleConfig`] on the vehicle, `radar.max_range_m` in the service. The smaller one counts.
//!
//! Nothing here reads a clock but the waits and deadlines of calls, the ids of uploads, and the cache's notes of
//! which tile was used when: time is what the sensors say.
//!
//! ```no_run
//! use echofix_client::service::ServiceAddress;
//! use echofix_client::vehicle::{Vehicle, VehicleConfig};
//! use echofix_client::{Localizer, LocalizerOptions};
//! # async fn drive(mounts: Vec<echofix_core::scan::Mount>) -> Result<(), Box<dyn std::error::Error>> {
//! let localizer = Localizer::new(ServiceAddress::at("http://127.0.0.1:50051").endpoint()?, LocalizerOptions::default());
//! let mut vehicle = Vehicle::new(VehicleConfig::default(), mounts);
//! // vehicle.push_odometry(..), vehicle.push_scan(..), vehicle.push_pose(..), then once a second:
//! let question = vehicle.question()?;
//! let answer = localizer.ask(&question).await?;
//! let fix = vehicle.accept(&question, &answer)?;
//! # Ok(())
//! # }
//! ```

pub mod backoff;
mod coverage;
mod disk;
pub mod drivelog;
pub mod filter;
#[cfg(feature = "csv")]
pub mod import;
mod localizer;
pub mod refusal;
mod routing;
pub mod service;
mod stream;
#[cfg(test)]
mod testing;
pub mod tiles;
pub mod upload;
pub mod vehicle;
pub mod wire;

pub use coverage::CoverageClient;
pub use localizer::{Localizer, LocalizerOptions};
pub use stream::{LocalizationStream, StreamTraffic};

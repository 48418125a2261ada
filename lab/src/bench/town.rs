//! A town that vehicles map by their uploads, and the requests of another vehicle in it.

use std::path::Path;
use std::sync::Arc;

use echofix_core::drive::Drive;
use echofix_sim::{City, CityParams, Route};
use indicatif::ProgressBar;
use serde::Serialize;

use super::BenchPlan;
use crate::machine::used_by;
use echofix_harness::process::ServiceProcess;
use echofix_harness::questions::{DriveQuestions, QuestionPlan};
use echofix_harness::{recording, town, uploading};

/// One contributor is enough to publish a cell, because few vehicles map the town.
pub const TRUSTING: &str = "mapping.publish_contributors=1";

/// Length of a batch, seconds.
const BATCH_S: f64 = 5.0;
/// Lengths of the batches that are compared, seconds.
const LENGTHS_S: [f64; 4] = [1.0, 2.0, 5.0, 8.0];

/// Days between mapping and localizing: other cars are parked by then.
const DAYS_LATER: u32 = 3;

/// What the vehicles' uploads cost the service, which decodes, writes, vets and folds them.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct UploadCost {
    /// Number of uploads.
    pub count: u64,
    /// Kilobytes of all of them on the wire.
    pub kb: f64,
    /// Milliseconds of the service's processor time for all of them; absent where the system does not report it.
    pub cpu_ms: Option<f64>,
}

/// A town whose map lies in a folder, and a drive in it.
pub(super) struct BenchTown {
    pub(super) uploads: UploadCost,
    pub(super) street_km: f64,
    pub(super) recording: Arc<DriveQuestions>,
    /// The requests of the same drive with batches of other lengths, by their seconds.
    pub(super) by_length: Vec<(f64, DriveQuestions)>,
    /// Metres driven from the first request to the last.
    pub(super) asked_over_m: f64,
}

impl BenchTown {
    /// Maps a town with a service that ends afterwards.
    pub(super) async fn mapped(plan: &BenchPlan, folder: &Path) -> anyhow::Result<Self> {
        let (blocks_x, blocks_y) = plan.blocks;
        let params = CityParams { seed: plan.seed, blocks_x, blocks_y, ..CityParams::default() };
        let city = City::generate(&params)?;
        let service = ServiceProcess::start(folder, &[TRUSTING.to_owned()]).await?;
        let used_ms = || Some(used_by(service.pid())?.as_secs_f64() * 1e3);
        let (began_ms, mut uploads) = (used_ms(), UploadCost::default());
        for vehicle in 0..plan.contributors {
            let seed = plan.seed * 1000 + vehicle;
            let name = format!("mapper-{vehicle}");
            let drive = town::drive(&city, 0, &Route::survey(&city, seed), name, seed)?;
            let spool = folder.join(format!("spool-{vehicle}"));
            let bar = ProgressBar::hidden();
            let (config, patience) = (recording::to_the_ends(), uploading::PATIENCE);
            let done = uploading::upload(&drive, &service.grpc, &spool, config, patience, &bar).await?;
            uploads.count += done.uploads;
            uploads.kb += done.bytes as f64 / 1e3;
        }
        service.folded().await?;
        uploads.cpu_ms = used_ms().zip(began_ms).map(|(after, before)| after - before);
        service.stop().await?;
        Self::localized(plan, &city, uploads)
    }

    /// Drives through the town on a later day, with a request each second.
    fn localized(plan: &BenchPlan, city: &City, uploads: UploadCost) -> anyhow::Result<Self> {
        let seed = plan.seed * 1000 + 999;
        let route = Route::survey(city, seed);
        let mut drive = town::drive(city, DAYS_LATER, &route, "lost".to_owned(), seed)?;
        let mut recording = DriveQuestions::of(&drive, &questions(plan, BATCH_S))?;
        if recording.count() > plan.questions {
            let end_us = recording.question(plan.questions - 1).time_us();
            cut(&mut drive, end_us);
            recording = DriveQuestions::of(&drive, &questions(plan, BATCH_S))?;
        }
        let (first, last) = (recording.question(0), recording.question(recording.count() - 1));
        let asked_over_m = drive.odometry.travelled_between_m(first.time_us(), last.time_us());
        let of_length = |batch_s| Ok((batch_s, DriveQuestions::of(&drive, &questions(plan, batch_s))?));
        let by_length = LENGTHS_S.into_iter().map(of_length).collect::<anyhow::Result<_>>()?;
        let street_km = city.streets_m() / 1e3;
        Ok(Self { uploads, street_km, recording: Arc::new(recording), by_length, asked_over_m })
    }
}

/// A request each second, with batches of this length.
fn questions(plan: &BenchPlan, batch_s: f64) -> QuestionPlan {
    QuestionPlan { batch_s, warm_up_s: batch_s, ..QuestionPlan::every(1.0, plan.seed) }
}

/// Removes the scans after `end_us`, so that the last request is for about that time.
fn cut(drive: &mut Drive, end_us: i64) {
    drive.scans.retain(|scan| scan.time_us <= end_us);
}

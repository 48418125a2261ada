//! A town, mapped through the vehicles' own uploads, and what another vehicle asks in it.

use std::path::Path;
use std::sync::Arc;

use echofix_core::drive::Drive;
use echofix_sim::{City, CityParams, Route};
use indicatif::ProgressBar;

use super::Plan;
use crate::commands::simulate;
use crate::contribute;
use crate::fixes::{self, Recording};
use crate::service::Service;

/// Two vehicles are enough to make a map.
pub const TRUSTING: &str = "mapping.publish_contributors=1";

/// Days between mapping and asking: the parked cars have changed.
const DAYS_LATER: u32 = 3;

/// A town whose map lies in a folder.
pub(super) struct Town {
    pub(super) street_km: f64,
    pub(super) recording: Arc<Recording>,
    /// Metres driven from the first question to the last.
    pub(super) asked_over_m: f64,
}

impl Town {
    /// Maps a town through a service that is ended afterwards.
    pub(super) async fn mapped(plan: &Plan, folder: &Path) -> anyhow::Result<Self> {
        let (blocks_x, blocks_y) = plan.blocks;
        let params = CityParams { seed: plan.seed, blocks_x, blocks_y, ..CityParams::default() };
        let city = City::generate(&params)?;
        let service = Service::start(folder, &[TRUSTING.to_owned()]).await?;
        for vehicle in 0..plan.contributors {
            let seed = plan.seed * 1000 + vehicle;
            let name = format!("mapper-{vehicle}");
            let drive = simulate::drive(&city, 0, &Route::survey(&city, seed), name, seed)?;
            let spool = folder.join(format!("spool-{vehicle}"));
            let bar = ProgressBar::hidden();
            contribute::upload(&drive, &service.grpc, &spool, contribute::simulated(), &bar).await?;
        }
        service.settled().await?;
        service.stop().await?;
        let (recording, asked_over_m) = asked(plan, &city)?;
        Ok(Self { street_km: city.streets_m() / 1e3, recording: Arc::new(recording), asked_over_m })
    }
}

/// What a vehicle asks on a later day, each second of a drive.
fn asked(plan: &Plan, city: &City) -> anyhow::Result<(Recording, f64)> {
    let seed = plan.seed * 1000 + 999;
    let mut drive = simulate::drive(city, DAYS_LATER, &Route::survey(city, seed), "lost".to_owned(), seed)?;
    let questions = fixes::Plan {
        every_s: 1.0,
        batch_s: 5.0,
        priors: 1,
        sigma_position_m: 2.0,
        sigma_yaw_rad: 3_f64.to_radians(),
        seed: plan.seed,
        warm_up_s: 5.0,
        at_once: 1,
    };
    let mut recording = Recording::of(&drive, &questions)?;
    if recording.len() > plan.questions {
        let end_us = recording.question(plan.questions - 1).time_us();
        cut(&mut drive, end_us);
        recording = Recording::of(&drive, &questions)?;
    }
    let (first, last) = (recording.question(0), recording.question(recording.len() - 1));
    let asked_over_m = drive.odometry.travelled_between_m(first.time_us(), last.time_us());
    Ok((recording, asked_over_m))
}

/// Ends a drive some time after `end_us`, so that its last question is for about then.
fn cut(drive: &mut Drive, end_us: i64) {
    drive.scans.retain(|scan| scan.time_us <= end_us);
}

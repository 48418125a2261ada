//! The maps of drive logs, made as the service makes them.

use std::path::Path;

use anyhow::{Context, ensure};
use echofix_core::drive::Drive;
use echofix_core::geo::Grid;

use super::{FleetPlan, read};
use crate::evaluate::crowd::map::CrowdMap;
use crate::evaluate::crowd::uploads::{SentForm, VehicleUpload, cut};
use crate::evaluate::map::{MapKey, Movers, RadarMap};
use crate::evaluate::world::grid_of;

/// The uploads of the logs that maps are made of, log by log.
pub struct MappingLogs {
    grid: Grid,
    uploads: Vec<Vec<VehicleUpload>>,
    publish_contributors: u8,
}

/// A map of some logs.
pub struct LogsMap {
    /// The map that is served.
    pub map: RadarMap,
    /// Uploads that were folded into it.
    pub folded: usize,
    /// Uploads that vetting kept out of it.
    pub quarantined: usize,
}

impl MappingLogs {
    /// Cuts the logs into uploads, on the grid that the first drive begins in. Logs of one vehicle are of one contributor.
    ///
    /// # Errors
    /// When a log cannot be read or mapped from, or a drive that is to be asked holds no known poses.
    pub fn read(plan: &FleetPlan) -> anyhow::Result<Self> {
        let first = plan.drives.first().context("name the drives to ask with --drives")?;
        let grid = known_grid(first, &read(first)?)?;
        let (mut vehicles, mut uploads) = (Vec::new(), Vec::new());
        let (max_sigma_m, max_range_m) = (plan.max_sigma_m, plan.questions.max_range_m);
        for path in plan.mapping() {
            let drive = read(path)?;
            if plan.map.is_empty() {
                known_grid(path, &drive)?;
            }
            let known = vehicles.iter().position(|vehicle| *vehicle == drive.vehicle);
            let contributor = known.unwrap_or(vehicles.len()) as u64;
            vehicles.push(drive.vehicle.clone());
            let form = SentForm { max_sigma_m, max_range_m, ..SentForm::of(contributor) };
            let cut =
                cut(&drive, grid.zone(), form).with_context(|| format!("mapping from {}", path.display()))?;
            ensure!(
                plan.map.is_empty() || !cut.is_empty(),
                "{} adds nothing to the map: it needs reference poses known to {max_sigma_m} m (--max-sigma-m) while it \
                 drives; leave it out of --map",
                path.display()
            );
            uploads.push(cut);
        }
        Ok(Self { grid, uploads, publish_contributors: plan.publish_contributors })
    }

    /// The grid of the maps.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The map of all logs, or of all but one.
    ///
    /// # Errors
    /// When nothing would be on it.
    pub fn map(&self, without: Option<usize>) -> anyhow::Result<LogsMap> {
        let mut crowd = CrowdMap::new(self.grid.zone());
        let (mut folded, mut quarantined) = (0, 0);
        let logs = self.uploads.iter().enumerate().filter(|(number, _)| Some(*number) != without);
        for upload in logs.flat_map(|(_, uploads)| uploads) {
            let count = if crowd.offer(upload).is_some() { &mut folded } else { &mut quarantined };
            *count += 1;
        }
        let tiles = crowd.published(self.publish_contributors, None);
        ensure!(
            !tiles.is_empty(),
            "the map is empty: of its logs' uploads {folded} were folded and {quarantined} quarantined. To be mapped from, \
             logs need good reference poses (--max-sigma-m says how good), and what is on the map {} vehicle(s) that saw \
             it (--publish-contributors)",
            self.publish_contributors
        );
        // No two maps may share prepared tiles.
        let key =
            MapKey { world: without.unwrap_or_default(), contributors: folded, movers: Movers::Excluded };
        Ok(LogsMap { map: RadarMap::of_tiles(key, self.grid.zone(), tiles), folded, quarantined })
    }
}

/// The grid of a drive that is asked, which needs poses to compare with.
fn known_grid(path: &Path, drive: &Drive) -> anyhow::Result<Grid> {
    grid_of(drive).with_context(|| {
        format!("{} must hold true poses, or reference poses to take for them", path.display())
    })
}

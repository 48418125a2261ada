//! `echofix evaluate --drives LOG...`: how good are the answers to recorded drives, and may they be believed?
//!
//! Maps are made as the service makes them, questions are asked as a vehicle asks them, and answers are compared with the
//! true poses of the logs.
//!
//! - [`options`]: the arguments. [`map`]: the maps of the logs. [`ask`]: all questions of a drive.
//! - [`figures`]: figures of many answers; [`stanford`]: errors against levels. [`page`]: the tables.

mod ask;
mod figures;
mod map;
pub mod options;
mod page;
mod stanford;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use echofix_core::drive::Drive;
use echofix_harness::progress;
use echofix_harness::questions::QuestionPlan;

use super::crowd::CrowdSection;
use super::method::Windows;
use super::trust::answer::NO_MAP;
use super::trust::record::write;
use ask::{AskedDrive, DriveAsker};
use map::MappingLogs;

/// Which drives are asked, on which maps and how.
#[derive(Debug, Clone)]
pub struct FleetPlan {
    /// The drive logs that are asked.
    pub drives: Vec<PathBuf>,
    /// The drive logs that the map is made of. Without any, each drive is asked on the map of the others.
    pub map: Vec<PathBuf>,
    /// When to ask, and from which priors.
    pub questions: QuestionPlan,
    /// Integrity risk of the protection levels.
    pub risk: f64,
    /// Alert limit of the Stanford diagram, metres.
    pub alert_limit_m: f64,
    /// Largest standard deviation of a reference pose that is mapped from, metres.
    pub max_sigma_m: f64,
    /// Contributors who must have seen something for it to be on the map.
    pub publish_contributors: u8,
    /// Memory for prepared map windows, mebibytes.
    pub windows_mib: u64,
    /// Where to write every question.
    pub rows: Option<PathBuf>,
    /// Whether to print only JSON.
    pub json: bool,
}

impl FleetPlan {
    /// The logs that maps are made of.
    fn mapping(&self) -> &[PathBuf] {
        if self.map.is_empty() { &self.drives } else { &self.map }
    }

    /// Refuses what would print figures that mean nothing.
    fn check(&self) -> anyhow::Result<()> {
        let QuestionPlan { every_s, batch_s, priors, sigma, .. } = &self.questions;
        ensure!(
            !self.map.is_empty() || self.drives.len() > 1,
            "one drive alone has no map to be asked on: name the logs of its map with --map, or several drives, each of \
             which is asked on the map of the others"
        );
        ensure!(*priors > 0 && *batch_s > 0.0, "--priors and --batch-s must be above 0");
        ensure!(
            every_s >= batch_s,
            "batches of {batch_s} s every {every_s} s would share scans and be no independent answers: leave out \
             --every-s, or give at least {batch_s}"
        );
        ensure!(
            sigma.position_m > 0.0 && sigma.yaw_rad > 0.0,
            "--sigma-position-m and --sigma-yaw-deg must be above 0: the search covers three of them"
        );
        ensure!(0.0 < self.risk && self.risk < 1.0, "--integrity-risk must lie between 0 and 1");
        ensure!(self.alert_limit_m > 0.0, "--alert-limit-m must be above 0");
        self.check_twice()
    }

    /// No drive may be asked on a map that it is part of.
    fn check_twice(&self) -> anyhow::Result<()> {
        let mut seen = Vec::new();
        for path in self.drives.iter().chain(&self.map) {
            let full = path.canonicalize().with_context(|| format!("reading {}", path.display()))?;
            ensure!(
                !seen.contains(&full),
                "{} is named twice: a drive must not be asked on a map that it is part of; name each log once",
                path.display()
            );
            seen.push(full);
        }
        Ok(())
    }
}

/// Asks all drives.
///
/// # Errors
/// When a log cannot be read, holds no truth or nothing to ask with, or a map is empty.
pub fn run(plan: &FleetPlan) -> anyhow::Result<CrowdSection> {
    plan.check()?;
    let asked = ask_all(plan)?;
    let rows: Vec<_> = asked.iter().flat_map(|drive| &drive.rows).cloned().collect();
    ensure!(
        rows.iter().any(|row| row.verdict != NO_MAP),
        "no drive comes near its map: the logs must be of the same streets, and their poses right"
    );
    if let Some(path) = &plan.rows {
        write(path, &rows).with_context(|| format!("writing {}", path.display()))?;
    }
    page::section(plan, &asked, &rows)
}

/// Asks each drive on its map. No more than one drive and one map are in memory.
fn ask_all(plan: &FleetPlan) -> anyhow::Result<Vec<AskedDrive>> {
    let logs = MappingLogs::read(plan)?;
    let shared = if plan.map.is_empty() { None } else { Some(logs.map(None)?) };
    let windows = Windows::new(plan.windows_mib);
    let bar = progress::bar("batches", 0, plan.json);
    let mut asked = Vec::new();
    for (number, path) in plan.drives.iter().enumerate() {
        let of_others;
        let map = if let Some(shared) = &shared {
            shared
        } else {
            of_others = logs.map(Some(number))?;
            &of_others
        };
        let asker = DriveAsker { plan, grid: logs.grid(), map, windows: &windows, bar: &bar };
        let (name, drive) = (name(&plan.drives, path), read(path)?);
        asked.push(asker.ask(number, name, &drive).with_context(|| {
            format!(
                "asking {}: a drive that is asked needs true poses, and must move for longer than --batch-s; leave it out of \
                 --drives otherwise",
                path.display()
            )
        })?);
    }
    bar.finish_and_clear();
    Ok(asked)
}

fn read(path: &Path) -> anyhow::Result<Drive> {
    super::logged::read(path)
}

/// The name of a log in tables: that of its file, unless another log has the same.
fn name(all: &[PathBuf], path: &Path) -> String {
    let alone = all.iter().filter(|other| other.file_name() == path.file_name()).count() < 2;
    let short = path.file_name().filter(|_| alone).map(Path::new);
    short.unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests;

//! A part of the report, with its figures.

use std::path::Path;

use super::condition::{Condition, Experiment};
use super::plots::{self, Curve, Panel};
use super::record::EpochRecord;
use super::simulated::is_scene;

/// A part of the report.
pub struct Section {
    /// The experiment.
    pub experiment: Experiment,
    /// Text and tables, in Markdown.
    pub text: String,
    /// The figures, with their file names.
    pub figures: Vec<(&'static str, Figure)>,
    /// The data it is made from, if it is not the fixes of the run.
    pub data: Option<String>,
}

/// A figure of the report.
pub enum Figure {
    /// Panels that show how often an error is exceeded.
    Ccdfs(Vec<Panel>),
    /// A title, and the receiver operating characteristics of detectors.
    Rocs(String, Vec<Curve>),
    /// A title, (error, protection level) pairs, and the alert limit, metres.
    Stanford(String, Vec<(f64, f64)>, f64),
    /// A title, and errors over days.
    Days(String, Vec<Curve>),
}

impl Section {
    /// Draws the figures into a folder.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn draw(&self, folder: &Path) -> anyhow::Result<()> {
        for (file, figure) in &self.figures {
            let path = folder.join(file);
            match figure {
                Figure::Ccdfs(panels) => plots::ccdfs(&path, panels)?,
                Figure::Rocs(title, curves) => plots::rocs(&path, title, curves)?,
                Figure::Stanford(title, pairs, alert_m) => plots::stanford(&path, title, pairs, *alert_m)?,
                Figure::Days(title, curves) => plots::days(&path, title, curves)?,
            }
        }
        Ok(())
    }
}

/// The fixes under a condition in towns or logs, without those in scenes.
pub fn under<'a>(rows: &[&'a EpochRecord], condition: &Condition, swept: bool) -> Vec<&'a EpochRecord> {
    let in_town = |r: &&&EpochRecord| !is_scene(r.site_kind);
    let matching = |r: &&&EpochRecord| r.condition == *condition && (!swept || r.swept);
    rows.iter().filter(in_town).filter(matching).copied().collect()
}

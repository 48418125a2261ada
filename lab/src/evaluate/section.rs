//! A part of the report, and what is drawn beside it.

use std::path::Path;

use super::condition::{Condition, Experiment};
use super::plots::{self, Curve, Panel};
use super::record::EpochRecord;
use super::simulated::is_scene;
use super::tables::ALERT_M;

/// A part of the report.
pub struct Section {
    /// Which experiment.
    pub experiment: Experiment,
    /// What is shown.
    pub text: String,
    /// File name and figure.
    pub figures: Vec<(&'static str, Figure)>,
    /// Where its figures come from, if not from the fixes that the sections share.
    pub data: Option<String>,
}

/// What is drawn.
pub enum Figure {
    /// Panels of how often an error is exceeded.
    Ccdfs(Vec<Panel>),
    /// A title and detectors' curves.
    Rocs(String, Vec<Curve>),
    /// A title and (error, level) pairs.
    Stanford(String, Vec<(f64, f64)>),
    /// A title and errors over days.
    Days(String, Vec<Curve>),
}

impl Section {
    /// Writes the figures.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn draw(&self, folder: &Path) -> anyhow::Result<()> {
        for (file, figure) in &self.figures {
            let path = folder.join(file);
            match figure {
                Figure::Ccdfs(panels) => plots::ccdfs(&path, panels)?,
                Figure::Rocs(title, curves) => plots::rocs(&path, title, curves)?,
                Figure::Stanford(title, pairs) => plots::stanford(&path, title, pairs, ALERT_M)?,
                Figure::Days(title, curves) => plots::days(&path, title, curves)?,
            }
        }
        Ok(())
    }
}

/// Rows of a condition: of the town or log, not of the scenes.
pub fn under<'a>(rows: &[&'a EpochRecord], condition: &Condition, swept: bool) -> Vec<&'a EpochRecord> {
    let in_town = |r: &&&EpochRecord| !is_scene(r.site_kind);
    let asked = |r: &&&EpochRecord| r.condition == *condition && (!swept || r.swept);
    rows.iter().filter(in_town).filter(asked).copied().collect()
}

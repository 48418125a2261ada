//! The experiment `vetting`: how many uploads does vetting keep out of the map, honest ones and ones with wrong poses?

use std::f64::consts::TAU;

use echofix_core::drive::Drive;
use echofix_core::geo::Zone;
use echofix_core::pose::Pose2;
use echofix_core::vetting::Vetted;
use rayon::prelude::*;
use serde::Serialize;

use super::map::CrowdMap;
use super::town::{self, Way};
use super::uploads::{SentForm, VehicleUpload, cut, cut_wrong};
use super::{CrowdSection, Scale, table};
use crate::evaluate::condition::Experiment;

/// Numbers of contributors to the maps that uploads are compared with.
const CROWDS: [u64; 3] = [1, 3, 10];

/// How the poses of an upload are wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wrong {
    No,
    /// Shifted by so many metres, each upload in another direction.
    Shift(f64),
    /// Turned by so many degrees about the middle of the upload.
    Turn(f64),
}

const WRONGS: [Wrong; 10] = [
    Wrong::No,
    Wrong::Shift(0.5),
    Wrong::Shift(0.6),
    Wrong::Shift(0.75),
    Wrong::Shift(1.0),
    Wrong::Shift(2.0),
    Wrong::Shift(5.0),
    Wrong::Turn(1.0),
    Wrong::Turn(2.0),
    Wrong::Turn(3.0),
];

impl Wrong {
    fn words(self) -> String {
        match self {
            Self::No => "honest".to_owned(),
            Self::Shift(m) => format!("shifted by {m} m"),
            Self::Turn(deg) => format!("turned by {deg} deg"),
        }
    }

    fn pose(self, number: usize, middle: Pose2, pose: Pose2) -> Pose2 {
        match self {
            Self::No => pose,
            Self::Shift(m) => {
                // Multiples of the golden angle never repeat.
                let (sin, cos) = (number as f64 * 0.381_966 * TAU).sin_cos();
                Pose2 { x_m: pose.x_m + m * cos, y_m: pose.y_m + m * sin, ..pose }
            }
            Self::Turn(deg) => {
                let centre = Pose2::new(middle.x_m, middle.y_m, 0.0);
                let turn = Pose2::new(0.0, 0.0, deg.to_radians());
                centre.compose(&turn).compose(&centre.inverse()).compose(&pose)
            }
        }
    }

    fn uploads(self, drive: &Drive, zone: Zone, contributor: u64) -> anyhow::Result<Vec<VehicleUpload>> {
        cut_wrong(drive, zone, SentForm::of(contributor), |number, middle, pose| {
            self.pose(number, middle, pose)
        })
    }
}

/// Numbers of uploads that agreed with the map, that were new to it, and that were quarantined.
type Counts = [usize; 3];

/// The counts in a town, by the number of contributors and by what was wrong.
fn counted(seed: u64) -> anyhow::Result<Vec<Vec<Counts>>> {
    let city = town::small(seed)?;
    let zone = city.site().zone();
    let [.., most] = CROWDS;
    // The uploads of the last two are compared with the maps of the others.
    let drive = |who: u64| town::drive(&city, who as u32, Way::Survey, who);
    let drives: Vec<_> = (0..most + 2).into_par_iter().map(drive).collect::<anyhow::Result<_>>()?;
    let (mapping, asking) = drives.split_at(most as usize);
    let questions: Vec<Vec<VehicleUpload>> = WRONGS
        .par_iter()
        .map(|wrong| {
            let uploads = asking.iter().zip(most..).map(|(drive, who)| wrong.uploads(drive, zone, who));
            Ok(uploads.collect::<anyhow::Result<Vec<_>>>()?.concat())
        })
        .collect::<anyhow::Result<_>>()?;
    let mut map = CrowdMap::new(zone);
    let mut all = Vec::new();
    for (drive, who) in mapping.iter().zip(0..) {
        for upload in cut(drive, zone, SentForm::of(who))? {
            map.offer(&upload);
        }
        if CROWDS.contains(&(who + 1)) {
            all.push(questions.iter().map(|uploads| count(&mut map, uploads)).collect());
        }
    }
    Ok(all)
}

fn count(map: &mut CrowdMap, uploads: &[VehicleUpload]) -> Counts {
    let mut counts = Counts::default();
    for upload in uploads {
        counts[match map.vet(upload) {
            Vetted::Agrees(_) => 0,
            Vetted::New(_) => 1,
            Vetted::Quarantined { .. } => 2,
        }] += 1;
    }
    counts
}

const WORDS: &str = "## Vetting

Uploads of about 10 s are compared with the maps of other contributors, who drove every street on other days. In brackets: how
many uploads lie where the map has nothing to compare them with.
";

/// A line of the table.
#[derive(Serialize)]
struct VettingLine {
    wrong: String,
    uploads: usize,
    crowds: [OfCrowd; CROWDS.len()],
}

/// What became of the uploads on the map of so many contributors.
#[derive(Serialize)]
struct OfCrowd {
    contributors: u64,
    quarantined: f64,
    new: usize,
}

impl VettingLine {
    fn of(which: usize, all: &[Vec<Vec<Counts>>]) -> Self {
        let sums = [0, 1, 2].map(|crowd| {
            let of_town = |town: &Vec<Vec<Counts>>| town[crowd][which];
            all.iter().map(of_town).fold(Counts::default(), |a, b| [0, 1, 2].map(|k| a[k] + b[k]))
        });
        let crowds = [0, 1, 2].map(|crowd: usize| {
            let [agree, new, out] = sums[crowd];
            let quarantined = out as f64 / (agree + new + out).max(1) as f64;
            OfCrowd { contributors: CROWDS[crowd], quarantined, new }
        });
        Self { wrong: WRONGS[which].words(), uploads: sums[0].iter().sum(), crowds }
    }

    fn cells(&self) -> String {
        let of = |crowd: &OfCrowd| format!("{:.1} % ({})", 100.0 * crowd.quarantined, crowd.new);
        let crowds = self.crowds.iter().map(of).collect::<Vec<_>>().join(" | ");
        format!("{} | {} | {crowds}", self.wrong, self.uploads)
    }
}

/// Runs the experiment.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(scale: &Scale) -> anyhow::Result<CrowdSection> {
    let towns = scale.towns(2);
    let all: Vec<_> = towns.iter().map(|seed| counted(*seed)).collect::<anyhow::Result<_>>()?;
    let lines: Vec<_> = (0..WRONGS.len()).map(|which| VettingLine::of(which, &all)).collect();
    let crowds = CROWDS.map(|count| format!("quarantined, map of {count}"));
    let columns: Vec<_> = ["", "uploads"].into_iter().chain(crowds.iter().map(String::as_str)).collect();
    let table = table(&columns, lines.iter().map(VettingLine::cells));
    CrowdSection::of_table(Experiment::Vetting, WORDS, &table, towns, &lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a turn that also shifts, and a shift of another length.
    #[test]
    fn poses_are_as_wrong_as_was_said() {
        let (middle, pose) = (Pose2::new(5.0, 5.0, 1.0), Pose2::new(8.0, 9.0, 1.2));
        for number in 0..5 {
            let shifted = Wrong::Shift(0.75).pose(number, middle, pose);
            assert!((shifted.distance_m(&pose) - 0.75).abs() < 1e-12);
            let turned = Wrong::Turn(2.0).pose(number, middle, pose);
            assert!((turned.distance_m(&middle) - 5.0).abs() < 1e-9);
            assert!((turned.yaw_rad - 1.2 - 2_f64.to_radians()).abs() < 1e-9);
            assert!(Wrong::Turn(2.0).pose(number, middle, middle).distance_m(&middle) < 1e-9);
        }
        assert_eq!(Wrong::No.pose(3, middle, pose), pose);
    }
}

//! The tables.

use super::FleetPlan;
use super::ask::AskedDrive;
use super::figures::{Errors, Figures};
use crate::evaluate::cells::{bounds, percent_cell, percentiles_cell};
use crate::evaluate::condition::Experiment;
use crate::evaluate::crowd::{CrowdSection, table};
use crate::evaluate::section::Figure;
use crate::evaluate::statistics::bootstrap::Estimate;
use crate::evaluate::trust::page::other_verdicts;
use crate::evaluate::trust::record::TrustRecord;

/// File of the Stanford diagram.
const STANFORD: &str = "drives-stanford.svg";

const ANSWERS: &str = "*Usable*, of the questions, is the availability. *Wrong* is USABLE and off by more than a metre.
*Beyond* is USABLE and beyond a protection level: along, across, or of the heading; each level may be exceeded with the
integrity risk. Brackets hold 95 % confidence intervals that draw whole batches, because many priors of one batch are not as
many answers; five batches are the least. Where nothing happened, the interval is that of the rule of three over the batches.
Batches of one drive share the errors of its truth and of the map, so that the intervals are narrow rather than wide.
";
const ERRORS: &str =
    "Errors of the usable answers, 50 / **95** / 99 percentiles over so many batches. Of fewer than 20
batches the 95 %, of fewer than 100 the 99 percentile is that of the worst batch.
";
const NEES: &str =
    "Mean squared errors in sigmas of the usable answers that are not wrong (NEES; 1 is right, more is too
sure of itself).
";

/// The section of the drives that were asked.
///
/// # Errors
/// When figures cannot be written as JSON.
pub fn section(plan: &FleetPlan, asked: &[AskedDrive], rows: &[TrustRecord]) -> anyhow::Result<CrowdSection> {
    let all: Vec<&TrustRecord> = rows.iter().collect();
    let limit_m = plan.alert_limit_m;
    let mut figures = vec![Figures::of("all drives", &all, limit_m)];
    figures.extend(
        asked.iter().map(|drive| Figures::of(&drive.name, &drive.rows.iter().collect::<Vec<_>>(), limit_m)),
    );
    let text = format!(
        "## Drives\n\n{}\n{}\n{ANSWERS}\n{}\n{ERRORS}\n{}\n{NEES}\n{}\n{}\n{}\n![Stanford diagram](figures/{STANFORD})\n",
        how(plan),
        drives(asked),
        answers(&figures),
        errors(&figures),
        nees(&figures),
        stanford_words(limit_m),
        stanford(&figures),
    );
    let data = format!("{} questions, priors of seed {}.", rows.len(), plan.questions.seed);
    let mut section = CrowdSection::with_data(Experiment::Drives, text, data, &figures)?;
    let usable = all.iter().filter(|row| row.usable());
    let pairs = usable.map(|row| (row.error_m(), row.level_m())).collect();
    let title = "errors, levels".to_owned();
    section.section.figures.push((STANFORD, Figure::Stanford(title, pairs, limit_m)));
    Ok(section)
}

/// How the drives were asked, in words.
fn how(plan: &FleetPlan) -> String {
    let questions = &plan.questions;
    let maps = if plan.map.is_empty() {
        "Each drive is asked on the map of the other drives".to_owned()
    } else {
        format!("The drives are asked on the map of {} other log(s)", plan.map.len())
    };
    format!(
        "{maps}, made and vetted as the service does; what {} vehicle(s) saw is on it. Batches of {} s, one every {} s, with \
         {} prior(s) each of sigma {} m and {:.1} deg; detections up to {} m; odometry of sigma {} m/s and {:.2} deg/s; \
         integrity risk {:e}.\n",
        plan.publish_contributors,
        questions.batch_s,
        questions.every_s,
        questions.priors,
        questions.sigma.position_m,
        questions.sigma.yaw_rad.to_degrees(),
        questions.max_range_m,
        questions.odometry.velocity_mps,
        questions.odometry.yaw_rate_radps.to_degrees(),
        plan.risk,
    )
}

fn drives(asked: &[AskedDrive]) -> String {
    let columns =
        ["", "uploads on its map", "quarantined", "compared with", "nothing to ask with", "suspicious"];
    let line = |drive: &AskedDrive| {
        let AskedDrive { name, uploads: (folded, quarantined), .. } = drive;
        let truth = if drive.has_truth { "its truth" } else { "its reference poses" };
        let not_asked: Vec<_> = drive.not_asked.iter().map(|(word, n)| format!("{n} {word}")).collect();
        format!(
            "{name} | {folded} | {quarantined} | {truth} | {} | {}",
            not_asked.join(", "),
            drive.findings.join("; ")
        )
    };
    table(&columns, asked.iter().map(line))
}

fn answers(figures: &[Figures]) -> String {
    let columns = [
        "",
        "batches",
        "questions",
        "usable",
        "wrong",
        "of batches",
        "of the usable",
        "beyond along, across, heading",
        "any, of the usable",
        "other verdicts",
    ];
    let line = |f: &Figures| {
        let [along, across, heading] = f.tally.beyond;
        format!(
            "{} | {} | {} | {} | {} | {} | {} | {along}, {across}, {heading} | {} | {}",
            f.drive,
            f.tally.batches,
            f.tally.questions,
            percent_cell(f.usable),
            f.tally.wrong,
            f.tally.wrong_batches,
            percent_cell(f.wrong),
            percent_cell(f.beyond),
            other_verdicts(&f.tally),
        )
    };
    table(&columns, figures.iter().map(line))
}

fn errors(figures: &[Figures]) -> String {
    let columns = ["", "batches", "horizontal, cm", "along, cm", "across, cm", "heading, deg"];
    let line = |f: &Figures| {
        let Errors { horizontal_m, along_m, cross_m, heading_deg } = &f.errors;
        let cm = |errors: &[Estimate]| percentiles_cell(errors, 100.0, 0);
        let deg = percentiles_cell(heading_deg, 1.0, 2);
        format!(
            "{} | {} | {} | {} | {} | {deg}",
            f.drive,
            f.usable_batches,
            cm(horizontal_m),
            cm(along_m),
            cm(cross_m)
        )
    };
    table(&columns, figures.iter().map(line))
}

fn nees(figures: &[Figures]) -> String {
    let line = |f: &Figures| {
        let nees = f.nees.map(|nees| {
            nees.map_or_else(|| "-".to_owned(), |e| format!("{:.2}{}", e.value, bounds(&e, 1.0, 2)))
        });
        format!("{} | {} | {}", f.drive, f.usable_batches, nees.join(" | "))
    };
    table(&["", "batches", "along", "across", "heading"], figures.iter().map(line))
}

fn stanford_words(limit_m: f64) -> String {
    format!(
        "Stanford diagram: horizontal errors of the usable answers against their levels, with an alert limit of {limit_m} m.
*Nominal*: the level bounds the error. *Unavailable*: it does, and exceeds the alert limit, so that the service would say
ABOVE_ALERT_LIMIT. *Misleading*: the error exceeds the level. *Hazardous*: it exceeds the alert limit, too, and the level does
not. Answers, and in brackets their batches.
"
    )
}

fn stanford(figures: &[Figures]) -> String {
    let line = |f: &Figures| {
        let hits = f.stanford.map(|hits| format!("{} ({})", hits.answers, hits.batches));
        format!("{} | {}", f.drive, hits.join(" | "))
    };
    table(&["", "nominal", "unavailable", "misleading", "hazardous"], figures.iter().map(line))
}

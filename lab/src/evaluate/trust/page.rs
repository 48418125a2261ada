//! The tables.

use super::case::Case;
use super::record::{TrustRecord, USABLE};
use super::tally::{CaseTally, Tally};
use crate::evaluate::condition::Experiment;
use crate::evaluate::crowd::{CrowdSection, table};

const WORDS: &str = "## Trust

Worlds of all families of `echofix_sim::family`, which differ in town, radars, density, clutter, noise, pace, crowd, pose
quality and age of the map, are mapped as the service maps them and asked in every way in which a question can be bad. Every
prior claims 2 m and 3 deg. Vehicles say nothing of their odometry, mounts and clocks and are taken for the worst, but where
errors are declared: there they are what they are said to be. *Wrong* is USABLE and off by more than a metre, or USABLE where there is nothing to be found;
*beyond* is USABLE and beyond the level of 1e-3 along, across, or of the heading. The first figure is the mean over families,
each counted once; the second the worst family's, with its name. Questions that share a batch are not independent: batches
are counted beside them. NEES is the mean squared error in sigmas of the usable answers that are not wrong (1 is right).
";

/// The section of these questions.
///
/// # Errors
/// When figures cannot be written as JSON.
pub fn section(rows: &[TrustRecord], cases: &[Case], seeds: &[u64]) -> anyhow::Result<CrowdSection> {
    let tallies: Vec<_> = cases
        .iter()
        .map(|case| CaseTally::of(&case.name, rows))
        .filter(|tally| tally.all.questions > 0)
        .collect();
    let mut words = format!("{WORDS}\n{}", by_case(&tallies));
    for named in ["right", "12 to 30 m off"] {
        if let Some(tally) = tallies.iter().find(|tally| tally.case == named) {
            words.extend(["\nBy family, `", named, "`:\n\n", &by_family(tally)]);
        }
    }
    words.extend(["\nVerdicts:\n\n", &verdicts(&tallies)]);
    let data =
        format!("Worlds of the seeds {}.", seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", "));
    CrowdSection::with_data(Experiment::Trust, words, data, &tallies)
}

fn percent(fraction: f64) -> String {
    format!("{:.1} %", 100.0 * fraction)
}

/// Parts of a thousand: what wrong answers are counted in.
fn permille(fraction: f64) -> String {
    if fraction == 0.0 { "0".to_owned() } else { format!("{:.1}", 1e3 * fraction) }
}

/// A figure, or a dash where there is none.
fn number(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "-".to_owned() }
}

fn by_case(tallies: &[CaseTally]) -> String {
    let columns = [
        "",
        "batches",
        "questions",
        "usable",
        "worst",
        "wrong",
        "of batches",
        "per 1000 questions",
        "worst",
        "beyond along, across, heading",
        "per 1000 usable",
        "worst",
        "NEES along, across, heading",
        "worst",
        "error 50, 95 %, cm",
    ];
    table(&columns, tallies.iter().map(case_line))
}

fn case_line(tally: &CaseTally) -> String {
    let CaseTally { case, all, .. } = tally;
    let worst = |figure: &dyn Fn(&Tally) -> f64, words: fn(f64) -> String| {
        // Where none is bad, none is the worst.
        let worst = tally.worst(figure).filter(|(_, figure)| *figure > 0.0);
        worst.map_or_else(|| "0".to_owned(), |(family, figure)| format!("{} {family}", words(figure)))
    };
    let least_usable = tally.worst(|t| -t.usable_rate());
    let least_usable = least_usable.map_or_else(String::new, |(f, rate)| format!("{} {f}", percent(-rate)));
    let nees_off = |t: &Tally| t.worst_nees().ln().abs();
    let worst_nees = tally
        .worst(nees_off)
        .and_then(|(family, _)| Some(format!("{:.2} {family}", tally.families.get(family)?.worst_nees())));
    let nees = [0, 1, 2].map(|axis| number(tally.mean(|t| t.nees[axis]), 2)).join(", ");
    let [along, cross, yaw] = all.beyond;
    format!(
        "{case} | {} | {} | {} | {least_usable} | {} | {} | {} | {} | {along}, {cross}, {yaw} | {} | {} | {nees} | {} | {}, {}",
        all.batches,
        all.questions,
        percent(tally.mean(Tally::usable_rate)),
        all.wrong,
        all.wrong_batches,
        permille(tally.mean(Tally::wrong_rate)),
        worst(&Tally::wrong_rate, permille),
        permille(tally.mean(Tally::beyond_rate)),
        worst(&Tally::beyond_rate, permille),
        worst_nees.unwrap_or_else(|| "-".to_owned()),
        number(100.0 * all.p50_m, 0),
        number(100.0 * all.p95_m, 0),
    )
}

fn by_family(tally: &CaseTally) -> String {
    let columns = [
        "",
        "batches",
        "questions",
        "usable",
        "wrong",
        "of batches",
        "beyond along, across, heading",
        "NEES along, across, heading",
        "error 50, 95 %, cm",
        "heading 95 %, deg",
        "other verdicts",
    ];
    let line = |(family, t): (&&'static str, &Tally)| {
        let nees = t.nees.map(|nees| number(nees, 2)).join(", ");
        let beyond = t.beyond.map(|count| count.to_string()).join(", ");
        format!(
            "{family} | {} | {} | {} | {} | {} | {beyond} | {nees} | {}, {} | {} | {}",
            t.batches,
            t.questions,
            percent(t.usable_rate()),
            t.wrong,
            t.wrong_batches,
            number(100.0 * t.p50_m, 0),
            number(100.0 * t.p95_m, 0),
            number(t.p95_deg, 2),
            other_verdicts(t),
        )
    };
    table(&columns, tally.families.iter().map(line))
}

fn verdicts(tallies: &[CaseTally]) -> String {
    let line =
        |tally: &CaseTally| format!("{} | {} | {}", tally.case, tally.all.usable, other_verdicts(&tally.all));
    table(&["", "usable", "others"], tallies.iter().map(line))
}

/// The verdicts but USABLE, the most frequent first.
pub fn other_verdicts(tally: &Tally) -> String {
    let mut others: Vec<_> = tally.verdicts.iter().filter(|(verdict, _)| **verdict != USABLE).collect();
    others.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    others.into_iter().map(|(verdict, count)| format!("{count} {verdict}")).collect::<Vec<_>>().join(", ")
}

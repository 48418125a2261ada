//! `echofix evaluate --only trust`: may answers be believed where nothing was tuned?
//!
//! Worlds of all families of [`echofix_sim::family`] are mapped as the service maps them, and asked in every way in which
//! a question can be bad.
//!
//! - [`case`]: the ways to ask. [`batch`]: what is wrong with a batch; [`prior`]: where a prior lies.
//! - [`world`]: a family's world with its maps, its vehicle and the truth. [`ask`]: all questions of a world; [`answer`]:
//!   their answers.
//! - [`record`]: one question with all of its answer. [`tally`]: many of them. [`page`]: the tables.
//! - [`bounds`]: what a quick run asserts.

pub mod answer;
mod ask;
pub mod batch;
mod bounds;
pub mod case;
pub mod page;
pub mod prior;
pub mod record;
pub mod tally;
mod world;

use std::path::PathBuf;

use anyhow::{Context, ensure};
use echofix_harness::progress;
use echofix_sim::Family;
use rayon::prelude::*;

use super::crowd::CrowdSection;
use record::TrustRecord;

/// Which worlds are asked.
#[derive(Debug, Clone)]
pub struct TrustPlan {
    /// The families.
    pub families: Vec<Family>,
    /// The seeds of each family's worlds.
    pub seeds: Vec<u64>,
    /// Whether to ask little, and to assert [`bounds`].
    pub quick: bool,
    /// Where to write every question.
    pub rows: Option<PathBuf>,
    /// Whether to print only JSON.
    pub json: bool,
}

/// Seeds a full run takes of those it is given.
const MOST_SEEDS: usize = 3;

impl TrustPlan {
    /// The families named, or all, without those named second.
    ///
    /// # Errors
    /// When none is left.
    pub fn families(only: &[Family], without: &[Family]) -> anyhow::Result<Vec<Family>> {
        let only = if only.is_empty() { &Family::ALL[..] } else { only };
        let left: Vec<_> = only.iter().copied().filter(|family| !without.contains(family)).collect();
        ensure!(!left.is_empty(), "no family is left: name fewer with --without, or more with --families");
        Ok(left)
    }
}

/// A family of `--families`.
///
/// # Errors
/// When there is none of this name.
pub fn family(word: &str) -> Result<Family, String> {
    Family::of_word(word).ok_or_else(|| {
        let all: Vec<_> = Family::ALL.iter().map(|family| family.word()).collect();
        format!("there is no family `{word}`; there are {}", all.join(", "))
    })
}

/// Runs the experiment.
///
/// # Errors
/// When a world cannot be made, a file cannot be written, or a quick run exceeds a bound.
pub fn run(plan: &TrustPlan) -> anyhow::Result<CrowdSection> {
    let most = if plan.quick { 1 } else { MOST_SEEDS };
    let seeds = &plan.seeds[..plan.seeds.len().min(most)];
    let worlds: Vec<_> =
        plan.families.iter().flat_map(|family| seeds.iter().map(move |seed| (*family, *seed))).collect();
    let cases = case::cases(plan.quick);
    let bar = progress::bar("worlds", worlds.len() as u64, plan.json);
    let rows = worlds.into_par_iter().map(|(family, seed)| {
        let rows = ask::ask(family, seed, &cases, plan.quick)
            .with_context(|| format!("the world {seed} of the family `{}`", family.word()));
        bar.inc(1);
        rows
    });
    let rows: Vec<TrustRecord> = rows.collect::<anyhow::Result<Vec<_>>>()?.into_iter().flatten().collect();
    bar.finish_and_clear();
    if let Some(path) = &plan.rows {
        record::write(path, &rows).with_context(|| format!("writing {}", path.display()))?;
    }
    let section = page::section(&rows, &cases, seeds)?;
    if plan.quick
        && let Err(broken) = bounds::check(&rows)
    {
        // What is out of bounds is found in the tables.
        println!("{}", section.section.text);
        return Err(broken);
    }
    Ok(section)
}

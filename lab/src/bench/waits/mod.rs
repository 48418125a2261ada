//! `echofix bench --waits`: what people wait for.
//!
//! - [`demo`]: from typing `echofix demo` to its first answer.
//! - [`town`]: the console's page and the map's tiles of a mapped town.
//! - [`history`]: a history of many uploads: to look at, and to start on.
//! - [`mod@page`]: the figures as a page.

mod demo;
mod history;
mod page;
mod town;

use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use echofix_harness::percentiles::Percentiles;
use serde::Serialize;

use super::BenchPlan;
use crate::machine::Machine;
use demo::Demo;
use history::History;
pub(super) use page::page;
use town::Town;

/// What was measured.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Waits {
    machine: Machine,
    seed: u64,
    demo: Demo,
    town: Town,
    history: History,
}

/// Measures with towns and maps of its own, and the command `program`.
///
/// # Errors
/// When a step fails.
pub(super) async fn run(
    plan: &BenchPlan,
    (program, folder): (&Path, &Path),
    say: &impl Fn(&str),
) -> anyhow::Result<Waits> {
    say("A demo.");
    let demo = demo::measure(program, plan.seed).await?;
    say("A town: the console's page, and tiles.");
    let town = town::measure(plan, &folder.join("town")).await?;
    say(&format!("A history of {} uploads.", plan.history));
    let history = history::measure(plan.history, &folder.join("history")).await?;
    Ok(Waits { machine: Machine::here(), seed: plan.seed, demo, town, history })
}

/// A connection to the operators' port that stays open, as a browser's does.
struct Browser {
    agent: ureq::Agent,
    root: String,
}

impl Browser {
    fn at(root: &str) -> Self {
        let config = ureq::Agent::config_builder().timeout_global(Some(std::time::Duration::from_mins(1)));
        Self { agent: config.build().new_agent(), root: root.to_owned() }
    }

    /// The body of an answer, and the milliseconds until it was there.
    fn get(&self, path: &str) -> anyhow::Result<(Vec<u8>, f64)> {
        let url = format!("{}/{path}", self.root);
        let began = Instant::now();
        let mut answer = self.agent.get(&url).call().with_context(|| format!("asking {url}"))?;
        let body = answer.body_mut().with_config().limit(1 << 30).read_to_vec()?;
        Ok((body, began.elapsed().as_secs_f64() * 1e3))
    }

    /// Milliseconds of so many answers, one after the other.
    fn often(&self, path: &str, times: usize) -> anyhow::Result<Percentiles> {
        let ms: Vec<f64> = (0..times).map(|_| Ok(self.get(path)?.1)).collect::<anyhow::Result<_>>()?;
        Percentiles::of(ms).context("nothing was asked")
    }
}

//! The paper's "Experimental Results" again, in one process: maps, drives and fixes without a service.
//!
//! - [`command`]: its arguments, and the order of the work.
//! - [`condition`]: under which conditions fixes are asked for, and which experiment compares which.
//! - [`map`]: a radar map in memory; [`floor`]: how far off its own poses were.
//! - [`world`]: maps of one day, a drive on another, the truth, [`simulated`] or [`logged`]; [`worlds`]: which.
//! - [`epoch`]: when is asked and with what; [`method`]: the methods under test.
//! - [`record`]: one fix beside the truth; [`mod@run`]: all of them.
//! - [`localizability`]: what the map alone expects of a fix, and what came of it.
//! - [`statistics`]: percentiles, intervals, curves.
//! - [`groups`], [`cells`], [`tables`], [`plots`]: what is shown; [`section`]: a part of the report;
//!   [`sections`]: all of them, experiment by experiment; of them [`ablation`] and [`misses`] have files of their own.
//! - [`crowd`]: experiments with towns, vehicles and maps of their own: a year, attacks, uploads.
//! - [`about`]: how the figures came about; [`summary`]: figures for machines.
//! - [`sanity`]: what any run must come out as.

pub mod ablation;
pub mod about;
pub mod cells;
pub mod command;
pub mod condition;
pub mod crowd;
pub mod epoch;
pub mod floor;
pub mod groups;
pub mod localizability;
pub mod logged;
pub mod map;
pub mod method;
pub mod misses;
pub mod plots;
pub mod record;
pub mod run;
pub mod sanity;
pub mod section;
pub mod sections;
pub mod simulated;
pub mod statistics;
pub mod summary;
pub mod tables;
pub mod world;
pub mod worlds;

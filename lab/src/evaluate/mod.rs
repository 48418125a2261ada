//! `echofix evaluate`: the paper's "Experimental Results" and further experiments, in one process and without a service.
//!
//! - [`command`]: the arguments and the order of the work.
//! - [`condition`]: the conditions under which fixes are made, and the experiments that compare them.
//! - [`map`]: a radar map in memory; [`floor`]: the map's own error.
//! - [`world`]: maps of one day, a drive of another and its truth, [`simulated`] or [`logged`]; [`worlds`]: all of a run.
//! - [`epoch`]: the epochs at which fixes are made; [`method`]: the methods that are compared.
//! - [`record`]: one fix beside the truth; [`mod@run`]: all fixes.
//! - [`localizability`]: what the map alone expects of a fix, beside the fix.
//! - [`statistics`]: percentiles, intervals, curves.
//! - [`groups`], [`cells`], [`tables`], [`plots`]: tables and figures; [`section`]: a part of the report; [`sections`]: all parts.
//!   [`ablation`] and [`misses`] have their own files.
//! - [`crowd`]: experiments with their own towns, vehicles and maps.
//! - [`about`]: how the figures were made; [`summary`]: the figures as JSON.
//! - [`sanity`]: bounds that every sound run keeps.

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

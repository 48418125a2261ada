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
//! - [`trust`]: whether answers may be believed in families of worlds that nothing was tuned on.
//! - [`fleet`]: recorded drives, asked on maps of recorded drives.
//! - [`about`]: how the figures were made; [`summary`]: the figures as JSON.
//! - [`sanity`]: bounds that every sound run keeps.

mod ablation;
mod about;
mod cells;
pub mod command;
mod condition;
mod crowd;
mod epoch;
mod fleet;
mod floor;
mod groups;
mod localizability;
mod logged;
mod map;
mod method;
mod misses;
mod plots;
mod record;
mod run;
mod sanity;
mod section;
mod sections;
mod simulated;
mod statistics;
mod summary;
mod tables;
mod trust;
mod world;
mod worlds;

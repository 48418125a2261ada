//! The arguments of `echofix evaluate --drives`.

use std::path::PathBuf;

use echofix_core::gate::MAX_RANGE_M;
use echofix_core::odometry::OdometryQuality;
use echofix_harness::prior::PriorSigma;
use echofix_harness::questions::QuestionPlan;
use echofix_harness::ranges::within;

use crate::evaluate::condition::BATCH_S;
use crate::evaluate::method::RISK;
use crate::evaluate::record::WRONG_M;

/// Which drives are asked, and how.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Your own drives")]
pub struct FleetOptions {
    /// Ask these drive logs, and compare the answers with the logs' true poses: may they be believed? With --map all are
    /// asked on the map of those logs, without it each on the map of the others. --every-s, --priors, --seed,
    /// --max-sigma-m, --windows-mib, --epochs and --write hold here, too.
    #[arg(long, value_name = "LOG", num_args = 1.., group = "logs", conflicts_with_all = [
        "quick", "world_seeds", "epochs_per_world", "swept_per_world", "only", "methods", "crowds", "families", "without",
    ])]
    pub drives: Vec<PathBuf>,
    /// Length of a batch, seconds.
    #[arg(long, default_value_t = BATCH_S, requires = "drives", value_parser = within(0.1..=60.0))]
    batch_s: f64,
    /// Standard deviation of the priors' position along each axis, metres.
    #[arg(long, default_value_t = 2.0, requires = "drives", value_parser = within(0.001..=1000.0))]
    sigma_position_m: f64,
    /// Standard deviation of the priors' heading, degrees.
    #[arg(long, default_value_t = 3.0, requires = "drives", value_parser = within(0.001..=180.0))]
    sigma_yaw_deg: f64,
    /// Largest range of a detection, metres. Farther ones are dropped, from maps and batches.
    #[arg(long, default_value_t = MAX_RANGE_M, requires = "drives", value_parser = within(1.0..=1000.0))]
    max_range_m: f64,
    /// Standard deviation of the odometry's velocity over a batch, metres per second.
    #[arg(long, default_value_t = OdometryQuality::default().velocity_mps, requires = "drives", value_parser = within(0.0..=10.0))]
    odometry_sigma_mps: f64,
    /// Standard deviation of the odometry's yaw rate over a batch, degrees per second.
    #[arg(long, default_value_t = OdometryQuality::default().yaw_rate_radps.to_degrees(), requires = "drives", value_parser = within(0.0..=57.0))]
    odometry_sigma_degps: f64,
    /// Probability with which a protection level may be exceeded.
    #[arg(long, default_value_t = RISK, requires = "drives", value_parser = within(1e-12..=0.5))]
    pub integrity_risk: f64,
    /// Alert limit of the Stanford diagram, metres.
    #[arg(long, default_value_t = WRONG_M, requires = "drives", value_parser = within(0.01..=1000.0))]
    pub alert_limit_m: f64,
    /// Vehicles who must have seen something for it to be on the map, as `mapping.publish_contributors` of the service.
    #[arg(long, default_value_t = 1, requires = "drives", value_parser = within(1..=255_u8))]
    pub publish_contributors: u8,
}

impl FleetOptions {
    /// When to ask, and from which priors. Without `every_s` batches follow each other.
    pub fn questions(&self, every_s: Option<f64>, priors: usize, seed: u64) -> QuestionPlan {
        QuestionPlan {
            every_s: every_s.unwrap_or(self.batch_s),
            batch_s: self.batch_s,
            warm_up_s: self.batch_s,
            priors,
            sigma: PriorSigma { position_m: self.sigma_position_m, yaw_rad: self.sigma_yaw_deg.to_radians() },
            seed,
            max_range_m: self.max_range_m,
            odometry: OdometryQuality {
                velocity_mps: self.odometry_sigma_mps,
                velocity_fraction: 0.0,
                yaw_rate_radps: self.odometry_sigma_degps.to_radians(),
            },
        }
    }
}

//! Files that changed are read again, and connections that no longer pass are told to go.
//!
//! The files are compared by what they hold: where they are mounted from secrets, links are swapped, which no watch of a file
//! sees.

use std::sync::Arc;

use tokio::time::MissedTickBehavior;

use super::gate::Gate;
use crate::metrics::Metrics;
use crate::sparse;

/// Keeps what connections are held against current for as long as it is polled.
pub async fn keep(gate: Arc<Gate>, metrics: Arc<Metrics>) {
    tell(&gate, &metrics);
    if !gate.has_files() {
        return;
    }
    let mut ticks = tokio::time::interval(gate.period());
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        refresh(&gate, &metrics).await;
    }
}

/// Reads again, and tells what came of it.
pub(super) async fn refresh(gate: &Arc<Gate>, metrics: &Metrics) {
    let again = Arc::clone(gate);
    let refreshed = match tokio::task::spawn_blocking(move || again.refresh()).await {
        Ok(refreshed) => refreshed.map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    match refreshed {
        Ok((changed, ended)) => {
            if changed {
                tracing::info!("certificates and tokens were read again");
                tell(gate, metrics);
            }
            if ended > 0 {
                tracing::info!(ended, "closed connections whose certificate or token no longer passes");
            }
        }
        Err(error) => {
            metrics.tls_reload_failures.inc();
            if let Some(left_out) = sparse::line("certificates cannot be read again") {
                tracing::error!(
                    error,
                    left_out,
                    "certificates or tokens cannot be used; the last good ones stay"
                );
            }
        }
    }
}

fn tell(gate: &Gate, metrics: &Metrics) {
    metrics.tls_not_after.set(gate.current().not_after.unwrap_or(0));
}

//! Health and metrics follow the store.

use super::Shared;
use crate::store::{Progress, State};

/// Follows the store's progress for as long as it is polled.
pub(super) async fn follow(shared: Shared) {
    let mut progress = shared.store.progress();
    loop {
        let Progress { state, epoch, journaled } = *progress.borrow_and_update();
        shared.metrics.epoch.set(epoch as i64);
        shared.metrics.unfolded.set(journaled.saturating_sub(epoch) as i64);
        match state {
            State::Rebuilding => {
                shared
                    .health
                    .not_ready(format!("rebuilding the map: {epoch} of {journaled} uploads are folded"));
            }
            // A map that cannot be folded on can still be read.
            State::Serving | State::Stalled => shared.health.ready(),
        }
        if progress.changed().await.is_err() {
            return;
        }
    }
}

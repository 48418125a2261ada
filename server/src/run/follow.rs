//! Health and metrics follow the store.

use super::ServiceContext;
use crate::store::{MapProgress, MapStatus};

/// Follows the store's progress for as long as it is polled.
pub(super) async fn follow(shared: ServiceContext) {
    let mut progress = shared.store.progress();
    loop {
        let now = *progress.borrow_and_update();
        let MapProgress { epoch, journaled, .. } = now;
        shared.metrics.epoch.set(epoch as i64);
        shared.metrics.unfolded.set(journaled.saturating_sub(epoch) as i64);
        match hindrance(&now) {
            Some(reason) => shared.health.not_ready(reason),
            None => shared.health.ready(),
        }
        if progress.changed().await.is_err() {
            return;
        }
    }
}

/// Why the service is not ready. A new generation that is made beside a sound one is no reason.
fn hindrance(progress: &MapProgress) -> Option<String> {
    let MapProgress { state, epoch, journaled, stopped, .. } = *progress;
    if stopped {
        return Some("the journal stopped after a write failed; restart once the disk is sound".to_owned());
    }
    match state {
        MapStatus::Rebuilding => {
            Some(format!("rebuilding the map: {epoch} of {journaled} uploads are folded"))
        }
        MapStatus::Stalled => {
            Some(format!("folding fails and is tried again: {epoch} of {journaled} uploads are folded"))
        }
        MapStatus::Serving => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Building;

    #[test]
    fn a_store_that_does_not_go_on_is_not_ready() {
        let reason = |state, stopped| {
            hindrance(&MapProgress {
                state,
                epoch: 3,
                journaled: 5,
                building: Some(Building { folded: 1, of: 5, control: 4 }),
                stopped,
            })
        };
        assert_eq!(
            reason(MapStatus::Serving, false),
            None,
            "while another generation is made, one is served"
        );
        assert!(reason(MapStatus::Serving, true).unwrap().contains("journal stopped"));
        assert!(reason(MapStatus::Stalled, false).unwrap().contains("3 of 5"));
        assert!(reason(MapStatus::Rebuilding, false).unwrap().contains("rebuilding"));
    }
}

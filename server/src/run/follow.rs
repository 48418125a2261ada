//! Health and metrics follow the store.

use super::ServiceContext;
use crate::health::{Readiness, ServiceReadiness};
use crate::store::{MapProgress, MapStatus};

/// Follows the store's progress for as long as it is polled.
pub(super) async fn follow(shared: ServiceContext) {
    let mut progress = shared.store.progress();
    loop {
        let now = *progress.borrow_and_update();
        let MapProgress { epoch, journaled, .. } = now;
        shared.metrics.rebuilding.set((now.building.is_some() || now.state == MapStatus::Rebuilding).into());
        shared.metrics.epoch.set(epoch as i64);
        shared.metrics.unfolded.set(journaled.saturating_sub(epoch) as i64);
        shared.health.set(readiness(&now));
        if progress.changed().await.is_err() {
            return;
        }
    }
}

/// What the store's progress means for those who ask. A new generation that is made beside a sound one hinders nobody.
fn readiness(progress: &MapProgress) -> ServiceReadiness {
    let MapProgress { state, epoch, journaled, stopped, refusing, .. } = *progress;
    let localizing = match state {
        MapStatus::Rebuilding => {
            Readiness::NotReady(format!("rebuilding the map: {epoch} of {journaled} uploads are folded"))
        }
        MapStatus::Stalled => Readiness::Degraded(format!(
            "folding fails and is tried again; the map of epoch {epoch} is served, {journaled} uploads are journaled"
        )),
        MapStatus::Serving => Readiness::Ready,
    };
    let uploading = if stopped {
        Readiness::NotReady("another service has taken the data directory over; end this one".to_owned())
    } else if refusing {
        Readiness::NotReady("the journal cannot be written; it is tried again".to_owned())
    } else {
        match &localizing {
            // The journal can be written: what is folded later is not lost.
            Readiness::NotReady(reason) => Readiness::Degraded(reason.clone()),
            other => other.clone(),
        }
    };
    ServiceReadiness { localizing, uploading }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Building;

    /// Catches: a service taken out of rotation while it can localize, or left in while it cannot.
    #[test]
    fn each_part_is_ready_when_it_can_work() {
        let of = |state, stopped, refusing| {
            let building = Some(Building { folded: 1, of: 5, control: 4 });
            readiness(&MapProgress { state, epoch: 3, journaled: 5, building, stopped, refusing })
        };
        assert_eq!(
            of(MapStatus::Serving, false, false),
            ServiceReadiness::of_all(&Readiness::Ready),
            "while another generation is made, one is served"
        );
        for (stopped, refusing) in [(true, false), (false, true), (true, true)] {
            let now = of(MapStatus::Serving, stopped, refusing);
            assert!(now.localizing.is_ready() && !now.uploading.is_ready());
        }
        let stalled = of(MapStatus::Stalled, false, false);
        assert!(stalled.localizing.is_ready() && stalled.uploading.is_ready());
        assert!(stalled.localizing.reason().unwrap().contains("epoch 3"));
        let rebuilding = of(MapStatus::Rebuilding, false, false);
        assert!(!rebuilding.localizing.is_ready() && rebuilding.uploading.is_ready());
    }
}

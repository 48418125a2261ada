//! What vetting keeps out of the map is told wherever operators look: the log, the metrics, the feed of uploads.

use std::collections::BTreeSet;
use std::time::Duration;

use echofix_core::vetting::alarm::alarms;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::MissedTickBehavior;

use super::ServiceContext;
use super::webhook::{Told, Webhook};
use crate::http::{alarm_message, quarantine_event};
use crate::metrics::OutcomeLabel;
use crate::store::QuarantinedRecord;

/// How often all that is in quarantine is counted, at most: it is all read for that.
const COUNTED: Duration = Duration::from_secs(2);

/// Tells of each for as long as it is polled.
pub(super) async fn tell(shared: ServiceContext) {
    let mut kept_out = shared.operations.kept_out();
    let mut ticks = tokio::time::interval(COUNTED);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // A decision or a rebuild changes the quarantine without telling of a record.
    let mut progress = shared.store.progress();
    let mut changed = true;
    let mut alarming = Alarming {
        told: Told::default(),
        webhook: Webhook::of(&shared.config.alarms, shared.metrics.clone()),
    };
    loop {
        tokio::select! {
            moved = progress.changed() => {
                if moved.is_err() {
                    return;
                }
                changed = true;
            }
            _ = ticks.tick(), if changed => changed = !count(&shared, &mut alarming).await,
            next = kept_out.recv() => {
                changed = true;
                match next {
                    Ok(record) => one(&shared, &record).await,
                    // They are in the quarantine all the same.
                    Err(RecvError::Lagged(missed)) => {
                        tracing::warn!(missed, "more uploads were kept out of the map");
                    }
                    Err(RecvError::Closed) => return,
                }
            }
        }
    }
}

/// What is known of alarms, and where they are sent.
struct Alarming {
    told: Told,
    webhook: Option<Webhook>,
}

async fn one(shared: &ServiceContext, record: &QuarantinedRecord) {
    let (operations, number) = (shared.operations.clone(), record.number);
    let ids = tokio::task::spawn_blocking(move || operations.upload_ids(&BTreeSet::from([number]))).await;
    let event = quarantine_event(record, ids.ok().and_then(|ids| ids.get(&number).copied()));
    let (reason, offset_m) = (event.reason, event.offset_m);
    // Neither id nor contributor: the log is read by more people than the quarantine.
    tracing::warn!(epoch = number, reason, offset_m, "vetting kept an upload out of the map");
    shared.metrics.quarantined.get_or_create(&OutcomeLabel { outcome: reason }).inc();
    shared.feed.quarantine(event);
}

/// How many there are, and how many alarms follow from them; false while the map is made anew, when nothing can be said.
async fn count(shared: &ServiceContext, alarming: &mut Alarming) -> bool {
    let operations = shared.operations.clone();
    let found = tokio::task::spawn_blocking(move || operations.quarantined()).await;
    let Ok(Ok(kept_out)) = found else { return false };
    let uploads: Vec<_> = kept_out.iter().map(|record| record.upload).collect();
    let config = &shared.config.alarms;
    let found = alarms(&uploads, &config.limits());
    for alarm in alarming.told.new_of(&found, config.within_m) {
        if let Some(webhook) = &alarming.webhook {
            webhook.put(alarm_message(&alarm, (&kept_out, config.within_m), &config.console));
        }
    }
    let alarms = found.len() as i64;
    shared.metrics.in_quarantine.set(kept_out.len() as i64);
    let before = shared.metrics.alarms.set(alarms);
    if alarms > before {
        tracing::error!(
            alarms,
            "several contributors disagree with the map alike: see `echofix map quarantine`"
        );
    }
    true
}

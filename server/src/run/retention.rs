//! Once a day, uploads that are older than the retention are compacted.

use std::time::Duration;

use echofix_core::time::day_of;

use super::ServiceContext;
use crate::grpc::now_us;

/// How often it is checked.
const TICK: Duration = Duration::from_hours(1);

/// Compacts for as long as it is polled.
pub(super) async fn keep(shared: ServiceContext) {
    let retention_days = shared.config.mapping.retention_days;
    if retention_days == 0 {
        return;
    }
    let mut ticks = tokio::time::interval(TICK);
    loop {
        ticks.tick().await;
        let operations = shared.operations.clone();
        let before = before_day(now_us(), retention_days);
        match tokio::task::spawn_blocking(move || operations.compact(before)).await {
            Ok(Ok(Some(number))) => tracing::info!(number, "uploads older than the retention are compacted"),
            Ok(Ok(None)) => {}
            Ok(Err(error)) => tracing::error!(%error, "old uploads could not be compacted; trying again"),
            Err(error) => tracing::error!(%error, "compacting old uploads did not end well"),
        }
    }
}

/// What was written before this day is compacted.
fn before_day(now_us: i64, retention_days: u16) -> u16 {
    day_of(now_us).saturating_sub(retention_days)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::time::DAY_US;

    #[test]
    fn the_retention_is_counted_back_from_today() {
        let day = |day| day * DAY_US + 7;
        assert_eq!(before_day(day(20_000), 90), 19_910);
        assert_eq!(before_day(day(3), 90), 0);
    }
}

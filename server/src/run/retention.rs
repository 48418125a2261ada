//! Once a day, what was kept long enough is made final.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::Shared;

/// How often the day is looked at.
const TICK: Duration = Duration::from_hours(1);
const DAY_S: u64 = 86_400;

/// Settles for as long as it is polled.
pub(super) async fn keep(shared: Shared) {
    let retention_days = shared.config.mapping.retention_days;
    if retention_days == 0 {
        return;
    }
    let mut ticks = tokio::time::interval(TICK);
    loop {
        ticks.tick().await;
        let operations = shared.operations.clone();
        let before = before_day(SystemTime::now(), retention_days);
        match tokio::task::spawn_blocking(move || operations.settle(before)).await {
            Ok(Ok(Some(number))) => tracing::info!(number, "uploads older than the retention are made final"),
            Ok(Ok(None)) => {}
            Ok(Err(error)) => tracing::error!(%error, "old uploads could not be made final; trying again"),
            Err(error) => tracing::error!(%error, "making old uploads final did not end well"),
        }
    }
}

/// What was written before this day is no longer kept.
fn before_day(now: SystemTime, retention_days: u16) -> u16 {
    let today = now.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() / DAY_S);
    u16::try_from(today).unwrap_or(u16::MAX).saturating_sub(retention_days)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_retention_is_counted_back_from_today() {
        let day = |day| UNIX_EPOCH + Duration::from_secs(day * DAY_S + 7);
        assert_eq!(before_day(day(20_000), 90), 19_910);
        assert_eq!(before_day(day(3), 90), 0);
    }
}

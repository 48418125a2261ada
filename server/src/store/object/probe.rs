//! Does a store keep its promises? Asked at every start: what ignores conditions loses acknowledged uploads.

use uuid::Uuid;

use super::bucket::Created;
use super::client::Client;
use crate::store::api::Error;

/// Names that are raced for, and racers for each.
const NAMES: usize = 8;
const RACERS: u8 = 8;

/// Lets creations race for names, and looks who won.
///
/// # Errors
/// [`Error::Unusable`] when the store lets several win or puts one object over another; or when it does not answer.
pub(in crate::store) fn probe(client: &Client) -> Result<(), Error> {
    let run = Uuid::now_v7();
    for number in 0..NAMES {
        let name = format!("probe/{run}-{number}");
        let raced = race(client, &name);
        // What is left of a failed probe is rubbish of a few bytes.
        let deleted = client.delete(&name);
        raced.and(deleted)?;
    }
    Ok(())
}

fn race(client: &Client, name: &str) -> Result<(), Error> {
    let body = |racer: u8| [racer; 64];
    let outcomes: Vec<_> = std::thread::scope(|scope| {
        let race = |racer| (racer, client.bucket().create(name, &body(racer)));
        let racers: Vec<_> = (0..RACERS).map(|racer| scope.spawn(move || race(racer))).collect();
        racers.into_iter().filter_map(|racer| racer.join().ok()).collect()
    });
    let won: Vec<u8> = outcomes
        .iter()
        .filter(|(_, outcome)| matches!(outcome, Ok(Created::Won)))
        .map(|(racer, _)| *racer)
        .collect();
    if won.len() > 1 {
        return Err(unusable(client, &format!("{} of {RACERS} racing creations of one name won", won.len())));
    }
    let unknown = outcomes.iter().any(|(_, outcome)| outcome.is_err());
    match client.get(name)? {
        // Nobody knows who won where an answer was lost.
        None if unknown => Ok(()),
        None => Err(unusable(client, "an object that was created is not there")),
        Some(found) => {
            let written = won.first().is_none_or(|racer| found == body(*racer));
            if !written || (won.is_empty() && !unknown) {
                return Err(unusable(client, "a creation that lost was written over the one that won"));
            }
            let again = client.bucket().create(name, &body(RACERS));
            if matches!(again, Ok(Created::Won)) || client.get(name)? != Some(found) {
                return Err(unusable(client, "an object was put over one that was there"));
            }
            Ok(())
        }
    }
}

fn unusable(client: &Client, reason: &str) -> Error {
    Error::Unusable(format!(
        "the object store {} does not keep the condition `If-None-Match: *`: {reason}. Acknowledged uploads would be lost. Use \
         a store that does: Amazon S3, Ceph or SeaweedFS",
        client.locate("")
    ))
}

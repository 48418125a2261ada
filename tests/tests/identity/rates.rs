//! How often one may ask the operators' port.

use std::time::Duration;

use super::site::{Caller, Site};

/// Asks until it was too often; returns when to come again, seconds.
fn until_refused(site: &Site, caller: &Caller, most: usize) -> Option<u64> {
    (0..most).find_map(|_| {
        let mut answer = caller.answer(site, "/api/v1/map");
        (answer.status() == 429).then(|| {
            let wait = answer.headers()["retry-after"].to_str().unwrap().parse().unwrap();
            let body = answer.body_mut().read_to_string().unwrap();
            assert!(body.contains("\"too_often\"") && body.contains("too often"), "{body}");
            wait
        })
    })
}

/// Catches: a caller that keeps the port busy for all others, and a refusal that says a time at which it is refused again.
#[tokio::test(flavor = "multi_thread")]
async fn a_caller_that_asks_without_end_is_told_when_to_come_again() {
    let site = Site::start_with(&["rates.http_per_s=1", "rates.http_address_per_s=0"]);
    let (viewer, operator) = (site.with_token("viewer"), site.certified("operator"));
    tokio::task::block_in_place(|| {
        let wait = until_refused(&site, &viewer, 200).expect("no end of answers");
        assert!((1..=4).contains(&wait), "{wait}");
        assert_eq!(viewer.status(&site, "/readyz"), 200, "a probe is always answered");
        assert_eq!(operator.status(&site, "/api/v1/map"), 200, "another caller of the same address");
        assert_eq!(
            site.with_jwt("viewer").status(&site, "/api/v1/map"),
            429,
            "the same name, known otherwise"
        );
        std::thread::sleep(Duration::from_secs(wait));
        assert_eq!(viewer.status(&site, "/api/v1/map"), 200);
    });
}

/// Catches: tokens that are tried without end, and an address that asks under many names.
#[tokio::test(flavor = "multi_thread")]
async fn an_address_is_counted_before_it_is_known_who_asks() {
    let site = Site::start_with(&["rates.http_per_s=0", "rates.http_address_per_s=1"]);
    let guesses = Caller::token(&site, "guesses", "echofix_0000");
    let viewer = site.with_token("viewer");
    tokio::task::block_in_place(|| {
        assert!(until_refused(&site, &guesses, 200).is_some(), "wrong tokens are tried without end");
        assert_eq!(viewer.status(&site, "/api/v1/map"), 429, "the same address");
        assert_eq!(viewer.status(&site, "/nowhere"), 429, "what is not served is asked for, too");
        assert_eq!(Caller::nobody(&site).status(&site, "/healthz"), 200);
    });
}

/// Catches: a proxy whose callers keep each other out.
#[tokio::test(flavor = "multi_thread")]
async fn behind_a_proxy_callers_are_counted_and_its_address_is_not() {
    let more = ["rates.http_per_s=1", "rates.http_address_per_s=1"];
    let site = Site::behind_a_proxy("x-echofix-caller", &more);
    let told = |who: &str| Caller::header(&site, "x-echofix-caller", who);
    tokio::task::block_in_place(|| {
        assert!(until_refused(&site, &told("viewer/alice"), 200).is_some());
        assert_eq!(told("viewer/bob").status(&site, "/api/v1/map"), 200);
    });
}

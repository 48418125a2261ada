//! Who may do what, on both ports of the real program, over real sockets, with certificates made here.
//!
//! - [`authority`]: certificates of all kinds, good and bad.
//! - [`authorities`]: whom the service itself believes.
//! - [`issuer`]: tokens of all kinds, good and bad.
//! - [`site`]: a service that asks who calls, and its callers.
//! - [`calls`]: everything that can be called, and who may.
//! - [`oidc`]: browsers sign in at an issuer; [`oidc_issuer`]: one.
//! - [`profiles`]: services and callers under names.
//! - [`rates`]: how often one may ask.
//! - [`sockets`]: both ports on unix sockets.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod authorities;
mod authority;
mod calls;
mod issuer;
mod oidc;
mod oidc_issuer;
mod profiles;
mod rates;
mod site;
mod sockets;

use std::time::Duration;

use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{UploadHeader, UploadRequest};
use echofix_tests::command::echofix;
use echofix_tests::{http, town, until_blocking};
use tonic::Code;

use calls::{Call, ROLES, all, may};
use issuer::Issuer;
use site::{Caller, Outcome, Site};

/// Catches: a call that somebody may make who should not, or may not who should, on either port, known by certificate, by
/// token or by an issuer's token; and a call that nobody thought of: what the service serves and `calls` does not list fails here.
#[tokio::test(flavor = "multi_thread")]
async fn identity_and_role_decide_every_call() {
    let site = Site::start();
    let calls = all(&site).await;
    let mut told = Vec::new();
    for role in ROLES {
        for caller in [site.certified(role), site.with_token(role), site.with_jwt(role)] {
            told.extend(
                unexpected(&site, &calls, &caller, |call| {
                    if may(role, call) { Outcome::Admitted } else { Outcome::Forbidden }
                })
                .await,
            );
        }
    }
    for caller in [Caller::nobody(&site), Caller::token(&site, "unknown token", "echofix_0000")] {
        told.extend(
            unexpected(&site, &calls, &caller, |call| {
                if may("nobody", call) { Outcome::Admitted } else { Outcome::Unauthenticated }
            })
            .await,
        );
    }
    // A certificate that is good and names no caller, and one whose common name claims to be an operator.
    for caller in [site.certified_as("no name", &[]), site.certified_as("operator", &["https://operator/a"])]
    {
        told.extend(
            unexpected(&site, &calls, &caller, |call| {
                if may("nobody", call) { Outcome::Admitted } else { Outcome::Unauthenticated }
            })
            .await,
        );
    }
    for caller in site.bad_jwts() {
        told.extend(
            unexpected(&site, &calls, &caller, |call| {
                if may("nobody", call) { Outcome::Admitted } else { Outcome::Unauthenticated }
            })
            .await,
        );
    }
    for caller in site.impostors() {
        told.extend(unexpected(&site, &calls, &caller, |_| Outcome::NotLetIn).await);
    }
    assert!(told.is_empty(), "{} surprises:\n{}", told.len(), told.join("\n"));
}

async fn unexpected(
    site: &Site,
    calls: &[Call],
    caller: &Caller,
    expected: impl Fn(&Call) -> Outcome,
) -> Vec<String> {
    let mut told = Vec::new();
    for call in calls {
        let (wanted, found) = (expected(call), site.outcome(caller, call).await);
        if wanted != found {
            told.push(format!("{} {call:?}: {found:?}, expected {wanted:?}", caller.who));
        }
    }
    told
}

/// Catches: one vehicle that is several witnesses because it gives several names, and a gateway that vouches for others'.
#[tokio::test(flavor = "multi_thread")]
async fn the_contributor_is_the_caller() {
    let site = Site::start();
    let named = async |caller: &Caller, contributor: &str| {
        let header = UploadHeader {
            upload_id: "018f4e3c-0000-7000-8000-000000000000".to_owned(),
            contributor: contributor.to_owned(),
            reference_time_us: 1_767_268_800_000_000,
            ..UploadHeader::default()
        };
        let parts = [UploadRequest { part: Some(Part::Header(header)) }];
        let mut client = caller.mapping();
        client.upload(tokio_stream::iter(parts)).await.unwrap_err()
    };
    let car = site.certified("mapper");
    for own in ["", "mapper-1"] {
        assert_eq!(named(&car, own).await.code(), Code::InvalidArgument, "goes on to what is missing");
    }
    for other in ["car-8", "mapper-1/b", "mapper-2"] {
        let refused = named(&car, other).await;
        assert_eq!(refused.code(), Code::PermissionDenied, "{other}");
        assert!(refused.message().contains("`mapper-1`") && refused.message().contains("empty"), "{refused}");
    }
    let fleet = site.with_token("gateway");
    assert_eq!(named(&fleet, "gateway-1/car-7").await.code(), Code::InvalidArgument);
    assert_eq!(named(&fleet, "gateway-2/car-7").await.code(), Code::PermissionDenied);
}

/// Catches: a service on the network that asks nobody because nobody thought of it, and a way out that does not work.
#[test]
fn a_port_that_others_reach_needs_identity_or_words() {
    let folder = tempfile::tempdir().unwrap();
    let check = |more: &[&str]| {
        let listen =
            ["serve", "--check-config", "--http-listen", "0.0.0.0:0", "--grpc-listen", "127.0.0.1:0"];
        echofix(listen.iter().chain(more))
    };
    let refused = check(&[]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    for way in ["echofix identity init", "echofix token create", "identity.proxy_header", "--anonymous"] {
        assert!(refused.stderr.contains(way), "{refused:?}");
    }
    assert_eq!(check(&["--anonymous=vehicle,viewer"]).code, Some(0));
    assert_eq!(check(&["--anonymous=admin"]).code, Some(1));
    assert_eq!(check(&["--set", "identity.tokens=/nonexistent"]).code, Some(2), "readable on the way");

    let dir = folder.path().join("identity").display().to_string();
    let made = echofix(["--json", "identity", "init", &dir, "--name", "127.0.0.1"]).json();
    let config = folder.path().join("echofix.toml");
    std::fs::write(&config, made["configuration"].as_str().unwrap()).unwrap();
    assert_eq!(check(&["--config", config.to_str().unwrap()]).code, Some(0));
    std::fs::write(folder.path().join("identity/server.key"), "nothing").unwrap();
    let broken = check(&["--config", config.to_str().unwrap()]);
    assert!(broken.code == Some(1) && broken.stderr.contains("`tls.key`"), "{broken:?}");
    let again = echofix(["identity", "init", &dir]);
    assert!(again.error().contains("holds something already"));
}

/// Catches: certificates of the command that the service does not take, commands that cannot use them, and keys that others on
/// the machine can read.
#[test]
fn what_init_prints_works_from_upload_to_status() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("identity").display().to_string();
    let made = echofix(["--json", "identity", "init", &dir, "--name", "127.0.0.1"]).json();
    for entry in std::fs::read_dir(&dir).unwrap().map(Result::unwrap) {
        let mode = std::os::unix::fs::PermissionsExt::mode(&entry.metadata().unwrap().permissions()) & 0o777;
        let key = entry.path().extension().is_some_and(|ending| ending == "key");
        assert!(!key || mode == 0o600, "{:?} has mode {mode:o}", entry.path());
    }
    let site = Site::configured(made["configuration"].as_str().unwrap(), &format!("{dir}/ca.pem"));
    let flags = |who: &str| made[who].as_str().unwrap().split(' ').map(str::to_owned).collect::<Vec<_>>();
    let run = |arguments: &[&str], who: &str| {
        echofix(arguments.iter().map(|&text| text.to_owned()).chain(flags(who)))
    };
    let log = folder.path().join("drive.mcap").display().to_string();
    let drive = town::wander(&town::town(7), 0, "car-1", 7, 300.0);
    echofix_client::drivelog::write(std::path::Path::new(&log), &drive).unwrap();
    let spool = folder.path().join("spool").display().to_string();
    let map = ["map", &log, "--server", &site.grpc, "--spool", &spool];
    let mapped = run(&map, "vehicle");
    assert_eq!(mapped.code, Some(0), "{mapped:?}");
    let other = run(&[&map[..], &["--contributor", "car-2"]].concat(), "vehicle");
    assert!(other.code == Some(1) && other.stderr.contains("car-1"), "{other:?}");
    let status = run(&["--json", "status", "--http", &site.http], "operator").json();
    assert_eq!(status["readiness"]["ready"], true);
    let history = ["--json", "map", "history", "--http", &site.http];
    assert!(run(&history, "operator").json()["events"][0]["uploads"].as_u64().unwrap() > 0);
    let refused = run(&history, "vehicle");
    assert!(refused.code == Some(1) && refused.stderr.contains("viewer"), "{refused:?}");
    let tiles = folder.path().join("tiles").display().to_string();
    let synced = run(&["tiles", "sync", &tiles, "--server", &site.grpc], "vehicle");
    assert_eq!(synced.code, Some(0), "{synced:?}");
    // Without --ca the public authorities count, and this is none of them.
    let stranger = echofix(["status", "--http", &site.http]);
    assert_eq!(stranger.code, Some(1), "{stranger:?}");
}

/// Catches: a revoked certificate or token that keeps its connection, a file that is broken for a moment and takes the service
/// down, and a change that is not seen because it is a link that was swapped.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_taken_back_ends_and_what_is_broken_is_not_taken() {
    let site = Site::start();
    let (car, operator, viewer) =
        (site.certified("vehicle"), site.certified("operator"), site.with_token("viewer"));
    let coverage = Call::rpc("/echofix.v1.MapService/GetCoverage");
    let read = Call::http("GET", "/api/v1/map");
    assert_eq!(site.outcome(&car, &coverage).await, Outcome::Admitted);
    assert_eq!(site.outcome(&viewer, &read).await, Outcome::Admitted);
    let mut health = car.watch_health().await;
    assert!(health.message().await.unwrap().is_some());

    site.revoke("vehicle");
    site.withdraw_token("viewer");
    let ended = tokio::time::timeout(Duration::from_secs(30), async {
        while let Ok(Some(_)) = health.message().await {}
    });
    ended.await.expect("the connection of a revoked certificate is closed");
    assert_eq!(site.outcome(&car, &coverage).await, Outcome::NotLetIn);
    assert_eq!(site.outcome(&viewer, &read).await, Outcome::Unauthenticated);
    assert_eq!(site.outcome(&operator, &read).await, Outcome::Admitted);

    let failures = || {
        let metrics = operator.get(&site, "/metrics");
        assert!(http::metric(&metrics, "echofix_tls_not_after_seconds") > 1.7e9);
        http::metric(&metrics, "echofix_tls_reload_failures_total")
    };
    let before = tokio::task::block_in_place(failures);
    site.break_files();
    tokio::task::block_in_place(|| {
        until_blocking("the broken files are noticed", Duration::from_secs(30), || {
            (failures() > before).then_some(())
        });
    });
    assert_eq!(site.outcome(&operator, &read).await, Outcome::Admitted);
    assert_eq!(site.outcome(&car, &coverage).await, Outcome::NotLetIn, "the last good list counts");
}

/// Catches: a browser's session that outlives its token or its sign-out, and a cookie that a script or another site can use.
#[tokio::test(flavor = "multi_thread")]
async fn browsers_sign_in_with_a_token() {
    let site = Site::start();
    let nobody = Caller::nobody(&site);
    let in_thread = |work: &dyn Fn() -> (u16, String)| tokio::task::block_in_place(work);
    let sign_in = |token: &str| {
        in_thread(&|| nobody.post(&site, "/session", &format!(r#"{{"token":"{token}"}}"#), &[]))
    };
    assert_eq!(sign_in("echofix_wrong").0, 401);
    let (status, cookie) = sign_in(&site.token("viewer"));
    assert_eq!(status, 200);
    for word in ["HttpOnly", "SameSite=Strict", "Secure", "Path=/"] {
        assert!(cookie.contains(word), "{cookie}");
    }
    let cookie = cookie.split(';').next().unwrap().to_owned();
    assert!(!cookie.contains(&site.token("viewer")));
    let browser = Caller::cookie(&site, &cookie);
    let who = tokio::task::block_in_place(|| browser.get(&site, "/session"));
    assert!(who.contains("viewer-1") && who.contains("token"), "{who}");
    let read = Call::http("GET", "/api/v1/map");
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Admitted);
    assert_eq!(site.outcome(&browser, &Call::http("GET", "/api/v1/fixes")).await, Outcome::Forbidden);
    let elsewhere = [("origin", "https://evil.example"), ("cookie", cookie.as_str())];
    assert_eq!(
        in_thread(&|| nobody.post(&site, "/session", "{}", &elsewhere)).0,
        403,
        "another page's request"
    );
    let out = |headers: &[(&str, &str)]| {
        tokio::task::block_in_place(|| browser.ask(&site, "DELETE", "/session", headers).status().as_u16())
    };
    assert_eq!(
        (out(&[]), out(&[("x-echofix-csrf", &cookie)])),
        (403, 403),
        "a page that is not the session's"
    );
    let who: serde_json::Value = serde_json::from_str(&who).unwrap();
    assert_eq!(out(&[("x-echofix-csrf", who["csrf"].as_str().unwrap())]), 204);
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Unauthenticated);

    let cookie = sign_in(&site.token("viewer")).1.split(';').next().unwrap().to_owned();
    let browser = Caller::cookie(&site, &cookie);
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Admitted);
    site.withdraw_token("viewer");
    tokio::task::block_in_place(|| {
        until_blocking("the token is gone", Duration::from_secs(30), || {
            let (status, _) =
                nobody.post(&site, "/session", &format!(r#"{{"token":"{}"}}"#, site.token("viewer")), &[]);
            (status == 401).then_some(())
        });
    });
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Unauthenticated);
}

/// Catches: a proxy's header that anybody may write, from the address it comes from.
#[tokio::test(flavor = "multi_thread")]
async fn a_proxy_on_this_machine_tells_who_asks() {
    let site = Site::behind_a_proxy("x-echofix-caller", &[]);
    let read = Call::http("GET", "/api/v1/map");
    let told = |value: &str| Caller::header(&site, "x-echofix-caller", value);
    assert_eq!(site.outcome(&told("viewer/alice"), &read).await, Outcome::Admitted);
    assert_eq!(site.outcome(&told("vehicle/car-7"), &read).await, Outcome::Forbidden);
    for wrong in ["alice", "root/alice", ""] {
        assert_eq!(site.outcome(&told(wrong), &read).await, Outcome::Unauthenticated, "{wrong}");
    }
    assert_eq!(site.outcome(&Caller::nobody(&site), &read).await, Outcome::Unauthenticated);
}

/// Catches: a key that was taken back and still signs, a new key that is not fetched, a stream and a session that outlive their
/// token, and a fetch for each token that somebody makes up.
#[tokio::test(flavor = "multi_thread")]
async fn an_issuers_keys_rotate_and_its_tokens_end() {
    let (mut issuer, next) = (Issuer::new("k1"), Issuer::new("k2"));
    let address = issuer::Published::start(&issuer.set());
    let site = Site::of_issuer(&address.url);
    let read = Call::http("GET", "/api/v1/map");
    let with = |issuer: &Issuer| Caller::token(&site, "of an issuer", &issuer.token("viewer"));
    tokio::task::block_in_place(|| {
        until_blocking("the keys are there", Duration::from_secs(30), || {
            (with(&issuer).status(&site, "/api/v1/map") == 200).then_some(())
        });
    });
    // Where to sign in, a token that ends soon is as good until then.
    let short = issuer.signed(&Issuer::claims("viewer", 4));
    let body = format!(r#"{{"token":"{short}"}}"#);
    let nobody = Caller::nobody(&site);
    let (status, cookie) = tokio::task::block_in_place(|| nobody.post(&site, "/session", &body, &[]));
    assert_eq!(status, 200);
    let browser = Caller::cookie(&site, cookie.split(';').next().unwrap());
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Admitted);
    let listener = Caller::token(&site, "a listener", &short);
    // Ends when the token does; the body of a stream that goes on is never whole.
    let heard = tokio::task::block_in_place(|| listener.get(&site, "/api/v1/events"));
    assert!(heard.contains("event: alive"), "{heard}");
    assert_eq!(site.outcome(&browser, &read).await, Outcome::Unauthenticated);
    assert_eq!(site.outcome(&listener, &read).await, Outcome::Unauthenticated);

    let before = address.asked();
    for _ in 0..50 {
        assert_eq!(site.outcome(&with(&next), &read).await, Outcome::Unauthenticated, "not published");
    }
    address.publish(&next.set());
    tokio::task::block_in_place(|| {
        until_blocking("the new key is fetched", Duration::from_mins(1), || {
            (with(&next).status(&site, "/api/v1/map") == 200).then_some(())
        });
    });
    assert!(address.asked() - before <= 20, "asked {} times", address.asked() - before);
    assert_eq!(site.outcome(&with(&issuer), &read).await, Outcome::Unauthenticated, "taken back");
    // The same id, another key.
    issuer.name("k2");
    assert_eq!(site.outcome(&with(&issuer), &read).await, Outcome::Unauthenticated);
    address.publish("<html>");
    assert_eq!(site.outcome(&with(&next), &read).await, Outcome::Admitted, "the last good keys count");
}

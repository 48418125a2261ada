//! Browsers sign in at an issuer.

use std::time::Duration;

use echofix_tests::until_blocking;
use serde_json::{Value, json};

use super::issuer::{Issuer, text};
use super::oidc_issuer::{Asked, OidcIssuer, SECRET, escaped, pairs};
use super::site::{Caller, Site};

const LONG: Duration = Duration::from_mins(1);

/// A browser on its way to the issuer.
struct Sent {
    asked: Asked,
    cookie: String,
}

/// How a browser comes back.
struct Back {
    status: u16,
    /// What was set of the session.
    session: Option<String>,
    body: String,
    cookies: Vec<String>,
}

fn cookies(answer: &ureq::http::Response<ureq::Body>) -> Vec<String> {
    let all = answer.headers().get_all("set-cookie").iter();
    all.map(|cookie| cookie.to_str().unwrap().to_owned()).collect()
}

fn sent(site: &Site, issuer: &OidcIssuer) -> Sent {
    let mut answer = Caller::nobody(site).answer(site, "/session/oidc");
    assert_eq!(answer.status(), 303, "{:?}", answer.body_mut().read_to_string());
    let location = answer.headers()["location"].to_str().unwrap().to_owned();
    let query =
        location.strip_prefix(&format!("{}/authorize?tenant=a&", issuer.url)).expect("the issuer's address");
    let cookie = cookies(&answer).pop().unwrap();
    for word in ["echofix_signin=", "HttpOnly", "SameSite=Lax", "Secure", "Path=/session;", "Max-Age=600"] {
        assert!(cookie.contains(word), "{cookie}");
    }
    Sent { asked: pairs(query), cookie: cookie.split(';').next().unwrap().to_owned() }
}

fn back(site: &Site, query: &str, cookie: &str) -> Back {
    let path = format!("/session/callback?{query}");
    // As browsers say it of a redirect from another site's page.
    let headers = [("cookie", cookie), ("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "navigate")];
    let mut answer = Caller::nobody(site).ask(site, "GET", &path, &headers);
    let cookies = cookies(&answer);
    let session = cookies.iter().find(|cookie| cookie.starts_with("echofix_session="));
    let session = session.map(|cookie| cookie.split(';').next().unwrap().to_owned());
    let body = answer.body_mut().read_to_string().unwrap();
    Back { status: answer.status().as_u16(), session, body, cookies }
}

fn query(code: &str, state: &str) -> String {
    format!("code={}&state={}", escaped(code), escaped(state))
}

/// Signs somebody in with roles; returns the session's cookie.
fn signed_in(site: &Site, issuer: &OidcIssuer, roles: &Value) -> Back {
    let sent = sent(site, issuer);
    let code = issuer.grant(&sent.asked, |claims| claims["roles"] = roles.clone(), Issuer::signed);
    back(site, &query(&code, &sent.asked["state"]), &sent.cookie)
}

fn site(issuer: &OidcIssuer) -> (Site, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let secret = folder.path().join("secret");
    std::fs::write(&secret, format!("{SECRET}\n")).unwrap();
    (Site::plain(issuer.settings(Some(&secret))), folder)
}

/// Catches: a sign-in that ends without a session, a session's cookie that a script or another site can use, one that the redirect
/// from another site does not come through with, and a change that any page can have a signed-in browser make.
#[tokio::test(flavor = "multi_thread")]
async fn browsers_sign_in_at_an_issuer() {
    let issuer = OidcIssuer::start();
    let (site, _folder) = site(&issuer);
    tokio::task::block_in_place(|| {
        let ways = Caller::nobody(&site).get(&site, "/session/ways");
        assert_eq!(serde_json::from_str::<Value>(&ways).unwrap(), json!({ "token": false, "oidc": true }));
        let signed = signed_in(&site, &issuer, &json!(["looks", "unheard of"]));
        assert_eq!(signed.status, 303, "{}", signed.body);
        let session = signed.cookies.iter().find(|cookie| cookie.starts_with("echofix_session=")).unwrap();
        for word in ["HttpOnly", "SameSite=Strict", "Secure", "Path=/;", "Max-Age=3600"] {
            assert!(session.contains(word), "{session}");
        }
        let ended = signed.cookies.iter().find(|cookie| cookie.starts_with("echofix_signin=;")).unwrap();
        assert!(ended.contains("Max-Age=0"), "{ended}");
        let viewer = Caller::cookie(&site, &signed.session.unwrap());
        let who: Value = serde_json::from_str(&viewer.get(&site, "/session")).unwrap();
        assert_eq!(
            (&who["name"], &who["roles"], &who["known_by"]),
            (&json!("alice"), &json!(["viewer"]), &json!("oidc"))
        );
        assert_eq!(viewer.status(&site, "/api/v1/map"), 200);
        assert_eq!(viewer.status(&site, "/api/v1/fixes"), 403);

        let operator = signed_in(&site, &issuer, &json!("looks decides")).session.unwrap();
        let operator = Caller::cookie(&site, &operator);
        let compact = |headers: &[(&str, &str)]| {
            let mut answer = operator.ask(&site, "POST", "/api/v1/map/undo", headers);
            (answer.status().as_u16(), answer.body_mut().read_to_string().unwrap())
        };
        let who: Value = serde_json::from_str(&operator.get(&site, "/session")).unwrap();
        let csrf = who["csrf"].as_str().unwrap();
        let (status, body) = compact(&[]);
        assert!(status == 403 && body.contains("\"csrf\""), "{status} {body}");
        assert_eq!(compact(&[("x-echofix-csrf", &"0".repeat(64))]).0, 403);
        let (status, body) = compact(&[("x-echofix-csrf", csrf)]);
        assert!(status == 400, "comes as far as the handler: {status} {body}");
        let out = operator.ask(&site, "DELETE", "/session", &[("x-echofix-csrf", csrf)]);
        assert_eq!((out.status().as_u16(), operator.status(&site, "/api/v1/map")), (204, 401));
        assert_eq!(viewer.status(&site, "/api/v1/map"), 200, "another's session");
    });
}

type Change = fn(&mut Value);
type Sign = fn(&Issuer, &Value) -> String;

fn unsigned(_: &Issuer, claims: &Value) -> String {
    format!("{}.{}.", text(r#"{"alg":"none"}"#), text(claims.to_string()))
}

/// ID tokens that are no good, with their names.
const BAD: [(&str, Change, Sign); 17] = [
    ("another nonce", |claims| claims["nonce"] = json!("0".repeat(64)), Issuer::signed),
    ("no nonce", |claims| drop(claims.as_object_mut().unwrap().remove("nonce")), Issuer::signed),
    ("another audience", |claims| claims["aud"] = json!("other"), Issuer::signed),
    ("no audience", |claims| drop(claims.as_object_mut().unwrap().remove("aud")), Issuer::signed),
    (
        "several audiences and no party",
        |claims| claims["aud"] = json!([claims["aud"], "other"]),
        Issuer::signed,
    ),
    ("another party", |claims| claims["azp"] = json!("other"), Issuer::signed),
    ("another issuer", |claims| claims["iss"] = json!("https://other.example"), Issuer::signed),
    ("no issuer", |claims| drop(claims.as_object_mut().unwrap().remove("iss")), Issuer::signed),
    ("expired", |claims| claims["exp"] = json!(claims["iat"].as_i64().unwrap() - 60), Issuer::signed),
    ("without end", |claims| drop(claims.as_object_mut().unwrap().remove("exp")), Issuer::signed),
    ("not yet valid", |claims| claims["nbf"] = json!(claims["iat"].as_i64().unwrap() + 600), Issuer::signed),
    ("no role", |claims| claims["roles"] = json!(["unheard of"]), Issuer::signed),
    ("no roles at all", |claims| drop(claims.as_object_mut().unwrap().remove("roles")), Issuer::signed),
    ("a name that is none", |claims| claims["sub"] = json!("a b"), Issuer::signed),
    ("of another key", |_| {}, |_, claims| Issuer::new("k1").signed(claims)),
    ("of an unknown key", |_| {}, |_, claims| Issuer::new("k9").signed(claims)),
    ("not signed", |_| {}, unsigned),
];

/// Catches: an answer that is not the issuer's, not for this service, not to this browser's question, not of this moment, or of
/// somebody who may nothing, and that begins a session all the same.
#[tokio::test(flavor = "multi_thread")]
async fn nobody_is_signed_in_by_anything_less() {
    let issuer = OidcIssuer::start();
    let (site, _folder) = site(&issuer);
    let refused = |what: &str, back: &Back| {
        assert_eq!((back.status, &back.session), (401, &None), "{what}: {}", back.body);
        assert!(back.cookies.iter().any(|cookie| cookie.contains("Max-Age=0")), "{what}");
    };
    let good = |sent: &Sent| issuer.grant(&sent.asked, |_| {}, Issuer::signed);
    tokio::task::block_in_place(|| {
        for (what, change, sign) in BAD {
            let sent = sent(&site, &issuer);
            let code = issuer.grant(&sent.asked, change, sign);
            refused(what, &back(&site, &query(&code, &sent.asked["state"]), &sent.cookie));
        }
        let (one, other) = (sent(&site, &issuer), sent(&site, &issuer));
        refused("another's state", &back(&site, &query(&good(&one), &other.asked["state"]), &one.cookie));
        refused("once more", &back(&site, &query(&good(&one), &one.asked["state"]), &one.cookie));
        // A code that somebody else got, put into this browser's answer.
        refused("another's code", &back(&site, &query(&good(&one), &other.asked["state"]), &other.cookie));
        let state = |sent: &Sent| escaped(&sent.asked["state"]);
        let each = [
            (
                "no cookie",
                true,
                Box::new(|sent: &Sent| query(&good(sent), &sent.asked["state"]))
                    as Box<dyn Fn(&Sent) -> String>,
            ),
            ("no state", false, Box::new(|sent: &Sent| format!("code={}", escaped(&good(sent))))),
            ("no code", false, Box::new(|sent: &Sent| format!("state={}", state(sent)))),
            ("a code that is none", false, Box::new(|sent: &Sent| query("none", &sent.asked["state"]))),
            ("an error", false, Box::new(|sent: &Sent| format!("error=access_denied&state={}", state(sent)))),
            (
                "of another issuer",
                false,
                Box::new(|sent: &Sent| {
                    format!("{}&iss=https%3A%2F%2Fother.example", query(&good(sent), &sent.asked["state"]))
                }),
            ),
        ];
        for (what, forgets, answer) in each {
            let sent = sent(&site, &issuer);
            let cookie = if forgets { "" } else { &sent.cookie };
            refused(what, &back(&site, &answer(&sent), cookie));
        }
        // A code counts once, whoever brings it.
        let sent = sent(&site, &issuer);
        let code = good(&sent);
        let again = query(&code, &sent.asked["state"]);
        assert_eq!(back(&site, &again, &sent.cookie).status, 303);
        refused("replayed", &back(&site, &again, &sent.cookie));
        let later = self::sent(&site, &issuer);
        refused("a used code", &back(&site, &query(&code, &later.asked["state"]), &later.cookie));
    });
}

/// Catches: a session that outlives the key that it rests on, and an issuer that is believed to be another.
#[tokio::test(flavor = "multi_thread")]
async fn sessions_end_with_the_issuers_key() {
    let issuer = OidcIssuer::start();
    // A public client: nothing proves who asks for the token but the verifier.
    let site = Site::plain(issuer.settings(None));
    tokio::task::block_in_place(|| {
        let session = signed_in(&site, &issuer, &json!(["looks"])).session.unwrap();
        let viewer = Caller::cookie(&site, &session);
        assert_eq!(viewer.status(&site, "/api/v1/map"), 200);
        issuer.rotate();
        let signed = signed_in(&site, &issuer, &json!(["looks"]));
        if signed.status != 303 {
            assert_eq!(signed.status, 401, "asked some seconds ago: {}", signed.body);
        }
        until_blocking("the session is over", LONG, || {
            (viewer.status(&site, "/api/v1/map") == 401).then_some(())
        });
        assert_eq!(signed_in(&site, &issuer, &json!(["looks"])).status, 303, "with the new key");

        let impostor = OidcIssuer::start();
        impostor.call_itself("https://other.example");
        let site = Site::plain(impostor.settings(None));
        let mut answer = Caller::nobody(&site).answer(&site, "/session/oidc");
        let body = answer.body_mut().read_to_string().unwrap();
        assert!(answer.status() == 502 && body.contains("another issuer"), "{body}");
    });
}

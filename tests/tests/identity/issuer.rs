//! An issuer of tokens: good ones, and all kinds of bad ones.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::hmac;
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, Ed25519KeyPair, KeyPair};
use serde_json::{Value, json};

use super::calls::ROLES;

pub const NAME: &str = "https://issuer.example";
const AUDIENCE: &str = "echofix";

/// Signs with ES256 and with `EdDSA`.
pub struct Issuer {
    kid: String,
    curve: EcdsaKeyPair,
    edwards: Ed25519KeyPair,
}

pub fn text(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

impl Issuer {
    pub fn new(kid: &str) -> Self {
        let random = SystemRandom::new();
        let made = EcdsaKeyPair::generate_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, &random).unwrap();
        let curve =
            EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, made.as_ref(), &random).unwrap();
        let made = Ed25519KeyPair::generate_pkcs8(&random).unwrap();
        Self { kid: kid.to_owned(), curve, edwards: Ed25519KeyPair::from_pkcs8(made.as_ref()).unwrap() }
    }

    /// Signs under another id from now on.
    pub fn name(&mut self, kid: &str) {
        kid.clone_into(&mut self.kid);
    }

    /// Settings of a service that believes it, and gives every role.
    pub fn settings(keys: &str) -> Vec<String> {
        let roles = ROLES.map(|role| format!("\"fleet-{role}s={role}\"")).join(",");
        vec![
            format!("identity.jwt_jwks={keys}"),
            format!("identity.jwt_issuer={NAME}"),
            format!("identity.jwt_audience={AUDIENCE}"),
            format!("identity.jwt_roles=[{roles}]"),
            "identity.jwt_refresh_s=3600".to_owned(),
            "identity.jwt_leeway_s=0".to_owned(),
        ]
    }

    /// Its public keys, with one that is a secret and must not count.
    pub fn set(&self) -> String {
        let point = self.curve.public_key().as_ref();
        let (x, y) = (text(&point[1..33]), text(&point[33..]));
        let edwards = text(self.edwards.public_key());
        json!({ "keys": [
            { "kty": "EC", "crv": "P-256", "kid": self.kid, "use": "sig", "x": x, "y": y },
            { "kty": "OKP", "crv": "Ed25519", "kid": format!("{}-ed", self.kid), "x": edwards },
            { "kty": "oct", "kid": "secret", "k": text("a secret that everybody knows") },
        ] })
        .to_string()
    }

    pub fn claims(role: &str, lasts_s: i64) -> Value {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() as i64;
        json!({ "iss": NAME, "aud": AUDIENCE, "sub": format!("{role}-1"), "nbf": now - 5,
                "exp": now + lasts_s, "roles": [format!("fleet-{role}s"), "unheard of"] })
    }

    pub fn signed(&self, claims: &Value) -> String {
        self.signed_with(&json!({ "alg": "ES256", "kid": self.kid }), claims)
    }

    fn signed_with(&self, header: &Value, claims: &Value) -> String {
        let message = format!("{}.{}", text(header.to_string()), text(claims.to_string()));
        let signature = self.curve.sign(&SystemRandom::new(), message.as_bytes()).unwrap();
        format!("{message}.{}", text(signature))
    }

    pub fn token(&self, role: &str) -> String {
        self.signed(&Self::claims(role, 3600))
    }

    /// The same by `EdDSA`.
    pub fn other_token(&self, role: &str) -> String {
        let header = json!({ "alg": "EdDSA", "kid": format!("{}-ed", self.kid) });
        let claims = Self::claims(role, 3600);
        let message = format!("{}.{}", text(header.to_string()), text(claims.to_string()));
        format!("{message}.{}", text(self.edwards.sign(message.as_bytes())))
    }

    /// What must not be taken, with its name.
    pub fn bad_tokens(&self) -> Vec<(&'static str, String)> {
        let good = || Self::claims("admin", 3600);
        let now = good()["nbf"].as_i64().unwrap();
        let with = |key: &str, value: Value| {
            let mut claims = good();
            claims[key] = value;
            self.signed(&claims)
        };
        let without = |key: &str| {
            let mut claims = good();
            claims.as_object_mut().unwrap().remove(key);
            self.signed(&claims)
        };
        let unsigned = |header: Value| format!("{}.{}", text(header.to_string()), text(good().to_string()));
        let by_secret = |kid: &str, secret: &[u8]| {
            let message = unsigned(json!({ "alg": "HS256", "kid": kid }));
            let tag = hmac::sign(&hmac::Key::new(hmac::HMAC_SHA256, secret), message.as_bytes());
            format!("{message}.{}", text(tag))
        };
        let (head, claims) =
            self.token("admin").split_once('.').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        vec![
            ("expired", with("exp", json!(now - 60))),
            ("not yet valid", with("nbf", json!(now + 600))),
            ("without exp", without("exp")),
            ("without nbf", without("nbf")),
            ("of another issuer", with("iss", json!("https://other.example"))),
            ("without issuer", without("iss")),
            ("for another audience", with("aud", json!(["other"]))),
            ("without audience", without("aud")),
            ("of another key", Issuer::new(&self.kid).token("admin")),
            ("of an unknown key", Issuer::new("k9").token("admin")),
            ("alg none", format!("{}.", unsigned(json!({ "alg": "none", "kid": self.kid })))),
            ("HS256 with the public key", by_secret(&self.kid, self.curve.public_key().as_ref())),
            ("HS256 with a listed secret", by_secret("secret", b"a secret that everybody knows")),
            (
                "another algorithm than it says",
                self.signed_with(&json!({ "alg": "RS256", "kid": self.kid }), &good()),
            ),
            (
                "critical and unheard of",
                self.signed_with(&json!({ "alg": "ES256", "kid": self.kid, "crit": ["x"], "x": 1 }), &good()),
            ),
            ("without key id", self.signed_with(&json!({ "alg": "ES256" }), &good())),
            ("roles that mean nothing", with("roles", json!(["admin", "root"]))),
            ("a name that is none", with("sub", json!("../root"))),
            ("too long", with("padding", json!("x".repeat(9000)))),
            ("changed", format!("{head}.{}{claims}", "e")),
        ]
    }
}

/// Keys at an address.
pub struct Published {
    pub url: String,
    set: Arc<Mutex<String>>,
    asked: Arc<AtomicUsize>,
}

impl Published {
    pub fn start(set: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/keys", listener.local_addr().unwrap());
        let (set, asked) = (Arc::new(Mutex::new(set.to_owned())), Arc::new(AtomicUsize::new(0)));
        let (now, count) = (Arc::clone(&set), Arc::clone(&asked));
        std::thread::spawn(move || {
            for mut stream in listener.incoming().map_while(Result::ok) {
                let mut head = Vec::new();
                while !head.ends_with(b"\r\n\r\n") {
                    let mut byte = [0];
                    if stream.read(&mut byte).unwrap_or(0) == 0 {
                        break;
                    }
                    head.push(byte[0]);
                }
                count.fetch_add(1, Ordering::Relaxed);
                let body = now.lock().unwrap().clone();
                let length = body.len();
                let head =
                    format!("HTTP/1.1 200 OK\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n");
                // Who left does not need it.
                let _ = stream.write_all((head + &body).as_bytes());
            }
        });
        Self { url, set, asked }
    }

    pub fn publish(&self, set: &str) {
        set.clone_into(&mut self.set.lock().unwrap());
    }

    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }
}

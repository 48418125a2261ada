//! An issuer at which browsers sign in: it describes itself, gives codes for what a browser was sent with, and ID tokens for codes.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ring::digest::{SHA256, digest};
use serde_json::{Value, json};

use super::issuer::{Issuer, text};

pub const CLIENT: &str = "echofix console";
pub const SECRET: &str = "s:e%c r=t";
pub const REDIRECT: &str = "https://maps.example/session/callback";

/// What a browser was sent to the issuer with.
pub type Asked = HashMap<String, String>;

pub struct OidcIssuer {
    pub url: String,
    state: Arc<Mutex<State>>,
}

struct State {
    issuer: Issuer,
    /// Who it says that it is.
    name: String,
    codes: HashMap<String, Grant>,
}

struct Grant {
    challenge: String,
    token: String,
}

impl OidcIssuer {
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let state = State { issuer: Issuer::new("k1"), name: url.clone(), codes: HashMap::new() };
        let state = Arc::new(Mutex::new(state));
        let (own, here) = (Arc::clone(&state), url.clone());
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                // Who left does not need an answer.
                let _ = answer(stream, &own, &here);
            }
        });
        Self { url, state }
    }

    /// Settings of a service whose browsers sign in here.
    pub fn settings(&self, secret: Option<&std::path::Path>) -> Vec<String> {
        let mut settings = vec![
            format!("identity.oidc_issuer={}", self.url),
            format!("identity.oidc_client_id={CLIENT}"),
            format!("identity.oidc_redirect={REDIRECT}"),
            "identity.jwt_roles=[\"looks=viewer\",\"decides=operator\"]".to_owned(),
            "identity.jwt_leeway_s=0".to_owned(),
            "identity.jwt_refresh_s=10".to_owned(),
        ];
        settings.extend(secret.map(|file| format!("identity.oidc_client_secret={}", file.display())));
        settings
    }

    /// Says that it is somebody else from now on.
    pub fn call_itself(&self, name: &str) {
        name.clone_into(&mut self.state.lock().unwrap().name);
    }

    /// Signs with another key from now on; the former one is taken back.
    pub fn rotate(&self) {
        self.state.lock().unwrap().issuer = Issuer::new("k2");
    }

    /// A code for somebody who signed in, as what a browser was sent with asks for. The claims may be changed, and the token.
    pub fn grant(
        &self,
        asked: &Asked,
        change: impl FnOnce(&mut Value),
        sign: impl FnOnce(&Issuer, &Value) -> String,
    ) -> String {
        for (key, value) in [
            ("response_type", "code"),
            ("client_id", CLIENT),
            ("redirect_uri", REDIRECT),
            ("scope", "openid profile"),
            ("code_challenge_method", "S256"),
        ] {
            assert_eq!(asked[key], value, "{key}");
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
        let mut claims = json!({ "iss": self.url, "aud": CLIENT, "sub": "alice", "iat": now, "exp": now + 60,
            "nonce": asked["nonce"], "roles": ["looks"] });
        change(&mut claims);
        let mut state = self.state.lock().unwrap();
        let token = sign(&state.issuer, &claims);
        let code = format!("code {}+&%", state.codes.len());
        state.codes.insert(code.clone(), Grant { challenge: asked["code_challenge"].clone(), token });
        code
    }
}

/// Pairs of a query or a form.
pub fn pairs(text: &str) -> Asked {
    text.split('&')
        .filter_map(|pair| pair.split_once('='))
        .map(|(key, value)| (plain(key), plain(value)))
        .collect()
}

fn plain(text: &str) -> String {
    let (mut bytes, mut rest) = (Vec::new(), text.bytes());
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digits = [rest.next().unwrap(), rest.next().unwrap()];
                u8::from_str_radix(std::str::from_utf8(&digits).unwrap(), 16).unwrap()
            }
            other => other,
        });
    }
    String::from_utf8(bytes).unwrap()
}

/// Text as a query takes it.
pub fn escaped(text: &str) -> String {
    let escapes: Vec<_> = text.bytes().map(|byte| format!("%{byte:02X}")).collect();
    escapes.concat()
}

fn answer(mut stream: TcpStream, state: &Mutex<State>, here: &str) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let (mut lines, mut length) = (Vec::new(), 0);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let line = line.trim_end().to_owned();
        if line.is_empty() {
            break;
        }
        if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap();
        }
        lines.push(line);
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body)?;
    let path = lines[0].split(' ').nth(1).unwrap_or_default().to_owned();
    let (status, body) = match path.as_str() {
        "/.well-known/openid-configuration" => {
            let name = state.lock().unwrap().name.clone();
            let described = json!({ "issuer": name, "authorization_endpoint": format!("{here}/authorize?tenant=a"),
                "token_endpoint": format!("{here}/token"), "jwks_uri": format!("{here}/keys") });
            (200, described.to_string())
        }
        "/keys" => (200, state.lock().unwrap().issuer.set()),
        "/token" => given(&lines, &pairs(std::str::from_utf8(&body).unwrap()), state),
        _ => (404, String::new()),
    };
    let head = format!(
        "HTTP/1.1 {status} X\r\ncontent-type: application/json\r\ncontent-length: {}\r\nconnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all((head + &body).as_bytes())
}

/// The ID token for a code: once, and only to whom the browser was sent by.
fn given(head: &[String], form: &Asked, state: &Mutex<State>) -> (u16, String) {
    let refused = |why: &str| (400, json!({ "error": why, "error_description": "x" }).to_string());
    let encoded = STANDARD.encode("echofix+console:s%3Ae%25c+r%3Dt");
    let proven =
        head.iter().any(|line| line.eq_ignore_ascii_case(&format!("authorization: Basic {encoded}")));
    let public = !head.iter().any(|line| line.to_ascii_lowercase().starts_with("authorization:"));
    if !(proven || public) || form["client_id"] != CLIENT {
        return (401, json!({ "error": "invalid_client" }).to_string());
    }
    if form["grant_type"] != "authorization_code" || form["redirect_uri"] != REDIRECT {
        return refused("invalid_request");
    }
    let Some(grant) = state.lock().unwrap().codes.remove(&form["code"]) else {
        return refused("invalid_grant");
    };
    if text(digest(&SHA256, form["code_verifier"].as_bytes())) != grant.challenge {
        return refused("invalid_grant");
    }
    let tokens =
        json!({ "access_token": "x", "token_type": "Bearer", "expires_in": 60, "id_token": grant.token });
    (200, tokens.to_string())
}

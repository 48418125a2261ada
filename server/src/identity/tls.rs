//! Certificate, key, authority, revocations, tokens and an issuer's keys: read from their files, checked, and made into what connections are
//! held against.

use std::fs::File;
use std::io::Read;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, CertificateRevocationListDer, PrivateKeyDer};
use rustls::server::danger::ClientCertVerifier;
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use rustls::version::TLS13;
use rustls::{RootCertStore, ServerConfig};

use super::certificate::not_after;
use super::config::{IdentityConfig, TlsConfig, TlsError};
use super::jwt;
use super::tokens::{MAX_BYTES, Tokens};
use crate::port::Port;

/// What the files hold, byte by byte.
#[derive(Clone, Default, PartialEq, Eq)]
pub(super) struct Files {
    certificate: Vec<u8>,
    key: Vec<u8>,
    client_ca: Vec<u8>,
    crl: Vec<u8>,
    tokens: Vec<u8>,
    jwks: Vec<u8>,
}

impl Files {
    /// Reads those that are named.
    pub(super) fn read(
        tls: &TlsConfig,
        identity: &IdentityConfig,
        fetched: &jwt::Source,
    ) -> Result<Self, TlsError> {
        let jwks = &identity.jwt_jwks;
        Ok(Self {
            certificate: read("tls.certificate", &tls.certificate)?,
            key: read("tls.key", &tls.key)?,
            client_ca: read("tls.client_ca", &tls.client_ca)?,
            crl: read("tls.crl", &tls.crl)?,
            tokens: read("identity.tokens", &identity.tokens)?,
            jwks: if jwt::is_address(jwks) { fetched.last() } else { read("identity.jwt_jwks", jwks)? },
        })
    }
}

fn read(key: &'static str, path: &str) -> Result<Vec<u8>, TlsError> {
    let failed = |reason: String| TlsError { key, path: path.to_owned(), reason };
    if path.is_empty() {
        return Ok(Vec::new());
    }
    let mut bytes = Vec::new();
    let opened = File::open(path).map(|file| file.take(MAX_BYTES + 1));
    opened.and_then(|mut file| file.read_to_end(&mut bytes)).map_err(|error| failed(error.to_string()))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(failed(format!("is larger than {MAX_BYTES} bytes")));
    }
    Ok(bytes)
}

/// What connections and requests are held against; replaced as a whole when a file changes.
#[derive(Clone, Default)]
pub struct Identified {
    /// For the two ports; none without TLS.
    configs: Option<(Arc<ServerConfig>, Arc<ServerConfig>)>,
    verifier: Option<Arc<dyn ClientCertVerifier>>,
    /// The end of the service's certificate, seconds since the Unix epoch.
    pub not_after: Option<i64>,
    pub(super) tokens: Tokens,
    /// The issuer's.
    pub(super) keys: jwt::Keys,
}

impl Identified {
    /// Checks everything: that it can be read, that key and certificate belong together, and that the time is not over.
    pub(super) fn of(files: &Files, tls: &TlsConfig, identity: &IdentityConfig) -> Result<Self, TlsError> {
        let failed = |key, path: &str, reason: String| TlsError { key, path: path.to_owned(), reason };
        let text = std::str::from_utf8(&files.tokens)
            .map_err(|error| failed("identity.tokens", &identity.tokens, error.to_string()))?;
        let tokens = Tokens::read(text)
            .map_err(|error| failed("identity.tokens", &identity.tokens, error.to_string()))?;
        let of_keys = |reason| failed("identity.jwt_jwks", &identity.jwt_jwks, reason);
        let keys = jwt::check(&files.jwks).map_err(of_keys)?;
        if keys.is_empty() && !identity.jwt_jwks.is_empty() && !jwt::is_address(&identity.jwt_jwks) {
            return Err(of_keys("is empty".to_owned()));
        }
        if !tls.is_on() {
            return Ok(Self { tokens, keys, ..Self::default() });
        }
        let verifier = verifier(files, tls)?;
        let of_certificate = |reason: String| failed("tls.certificate", &tls.certificate, reason);
        let chain = certificates(&files.certificate).map_err(of_certificate)?;
        let not_after = chain.first().and_then(|certificate| not_after(certificate));
        let not_after = not_after.ok_or_else(|| of_certificate("cannot be read".to_owned()))?;
        if not_after <= now_s() {
            return Err(of_certificate("has expired; renew it".to_owned()));
        }
        let key = PrivateKeyDer::from_pem_slice(&files.key)
            .map_err(|_| failed("tls.key", &tls.key, "holds no private key in PEM".to_owned()))?;
        let config = config(chain, key, verifier.clone()).map_err(of_certificate)?;
        let with = |protocols: &[&[u8]]| {
            let mut config = config.clone();
            config.alpn_protocols = protocols.iter().map(|protocol| protocol.to_vec()).collect();
            Arc::new(config)
        };
        let configs = Some((with(&[b"h2"]), with(&[b"h2", b"http/1.1"])));
        Ok(Self { configs, verifier, not_after: Some(not_after), tokens, keys })
    }

    /// The configuration of a port; none without TLS.
    #[must_use]
    pub fn config(&self, port: Port) -> Option<Arc<ServerConfig>> {
        let (grpc, http) = self.configs.as_ref()?;
        Some(Arc::clone(if port == Port::Grpc { grpc } else { http }))
    }

    /// Whether a client's certificates, its own first, would be taken now.
    pub(super) fn takes(&self, chain: &[CertificateDer<'_>]) -> bool {
        let (Some(verifier), Some((own, between))) = (&self.verifier, chain.split_first()) else {
            return false;
        };
        verifier.verify_client_cert(own, between, rustls::pki_types::UnixTime::now()).is_ok()
    }
}

pub(super) fn now_s() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs() as i64)
}

fn certificates(pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, String> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    let found = found.map_err(|error| format!("is no PEM: {error}"))?;
    if found.is_empty() { Err("holds no certificate in PEM".to_owned()) } else { Ok(found) }
}

/// What checks clients' certificates. A client without one is let in, and known by its token or not at all.
fn verifier(files: &Files, tls: &TlsConfig) -> Result<Option<Arc<dyn ClientCertVerifier>>, TlsError> {
    if tls.client_ca.is_empty() {
        return Ok(None);
    }
    let of_ca = |reason: String| TlsError { key: "tls.client_ca", path: tls.client_ca.clone(), reason };
    let of_crl = |reason: String| TlsError { key: "tls.crl", path: tls.crl.clone(), reason };
    let mut roots = RootCertStore::empty();
    for authority in certificates(&files.client_ca).map_err(of_ca)? {
        roots.add(authority).map_err(|error| of_ca(error.to_string()))?;
    }
    let mut builder = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider());
    if !tls.crl.is_empty() {
        let lists: Result<Vec<_>, _> = CertificateRevocationListDer::pem_slice_iter(&files.crl).collect();
        let lists = lists.map_err(|error| of_crl(format!("is no PEM: {error}")))?;
        if lists.is_empty() {
            return Err(of_crl("holds no list of revoked certificates in PEM".to_owned()));
        }
        builder = builder.with_crls(lists);
    }
    let built = builder.allow_unauthenticated().build();
    built.map(Some).map_err(|error| {
        if tls.crl.is_empty() { of_ca(error.to_string()) } else { of_crl(error.to_string()) }
    })
}

fn config(
    chain: Vec<CertificateDer<'static>>,
    key: PrivateKeyDer<'static>,
    verifier: Option<Arc<dyn ClientCertVerifier>>,
) -> Result<ServerConfig, String> {
    let builder = ServerConfig::builder_with_provider(provider()).with_protocol_versions(&[&TLS13]);
    let builder = builder.map_err(|error| error.to_string())?;
    let builder = match verifier {
        Some(verifier) => builder.with_client_cert_verifier(verifier),
        None => builder.with_no_client_auth(),
    };
    let mut config = builder.with_single_cert(chain, key).map_err(|error| match error {
        rustls::Error::InconsistentKeys(_) => "does not belong to the key in tls.key".to_owned(),
        other => other.to_string(),
    })?;
    // A session that is resumed is not held against the list of revoked certificates again.
    config.session_storage = Arc::new(NoServerSessionStorage {});
    config.send_tls13_tickets = 0;
    Ok(config)
}

fn provider() -> Arc<rustls::crypto::CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

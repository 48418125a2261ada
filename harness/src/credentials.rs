//! Who the command is to a service, and whom it believes: the same flags for both ports.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use echofix_client::service::{ServiceAddress, ServiceEndpoint};
use ureq::tls::{Certificate, ClientCert, PemItem, PrivateKey, RootCerts, TlsConfig, parse_pem};

use crate::profile::{self, Profile};

/// Where a service's ports are on this machine, unless something else is said.
const SERVER: &str = "http://127.0.0.1:50051";
const HTTP: &str = "http://127.0.0.1:8080";

/// Flags of every command that calls a service.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Identity")]
pub struct Credentials {
    /// PEM file of the authority that signed the service's certificate. Without it the public authorities count.
    #[arg(long, global = true, value_name = "FILE", env = "ECHOFIX_CA")]
    pub ca: Option<PathBuf>,
    /// PEM file of the certificate by which the service knows the caller.
    #[arg(long, global = true, value_name = "FILE", env = "ECHOFIX_CERT")]
    pub cert: Option<PathBuf>,
    /// PEM file of that certificate's key.
    #[arg(long, global = true, value_name = "FILE", env = "ECHOFIX_KEY")]
    pub key: Option<PathBuf>,
    /// Token by which the service knows the caller. The variable does not show it to other users of the machine.
    #[arg(long, global = true, env = "ECHOFIX_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Name of a profile in `~/.config/echofix/profiles.toml`: a service's addresses, and who the command is to it. What flags and
    /// variables say counts before it.
    #[arg(long, global = true, value_name = "NAME", env = "ECHOFIX_PROFILE")]
    pub profile: Option<String>,
    /// What the profile says of the vehicles' port and of the operators'.
    #[arg(skip)]
    pub addresses: (Option<String>, Option<String>),
}

impl Credentials {
    /// With what the profile says, where one is named, and nothing else does.
    ///
    /// # Errors
    /// When the profile cannot be used.
    pub fn resolved(mut self) -> anyhow::Result<Self> {
        let Some(name) = self.profile.take().filter(|name| !name.is_empty()) else { return Ok(self) };
        let Profile { server, http, ca, cert, key, token, .. } = Profile::named(&name, &profile::file()?)?;
        self.addresses = (server, http);
        self.ca = self.ca.or(ca);
        // Who asks is said in one place: a profile's token would count before a certificate that a flag names.
        if self.cert.is_none() && self.key.is_none() && self.token.is_none() {
            (self.cert, self.key, self.token) = (cert, key, token);
        }
        Ok(self)
    }

    /// URL of the vehicles' port: what was given, or what the profile says, or this machine's.
    #[must_use]
    pub fn server<'a>(&'a self, given: Option<&'a str>) -> &'a str {
        given.or(self.addresses.0.as_deref()).unwrap_or(SERVER)
    }

    /// The same of the operators' port.
    #[must_use]
    pub fn http<'a>(&'a self, given: Option<&'a str>) -> &'a str {
        given.or(self.addresses.1.as_deref()).unwrap_or(HTTP)
    }

    /// The vehicles' port of a service. Certificates count for `https://` only, so that a variable that is set harms no call to
    /// this machine.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub fn endpoint(&self, url: &str) -> anyhow::Result<ServiceEndpoint> {
        let mut address = ServiceAddress { token: self.token.clone(), ..ServiceAddress::at(url) };
        if url.starts_with("https://") {
            address.ca_pem = self.ca.as_deref().map(read).transpose()?;
            address.identity_pem = self.identity()?;
        }
        Ok(address.endpoint()?)
    }

    /// A client of the operators' port.
    ///
    /// # Errors
    /// When a file cannot be read or used, or a token would go to another machine readable.
    pub fn agent(&self, url: &str, patience: Duration) -> anyhow::Result<ureq::Agent> {
        let by_socket = "the operators' port of a service is asked by http:// or https://; a unix socket of it is for a proxy";
        ensure!(!url.starts_with("unix:"), by_socket);
        let mut tls = TlsConfig::builder();
        if url.starts_with("https://") {
            if let Some(ca) = &self.ca {
                tls = tls.root_certs(RootCerts::new_with_certs(&certificates(&read(ca)?)?));
            }
            if let Some((certificate, key)) = self.identity()? {
                let key = PrivateKey::from_pem(key.as_bytes()).context("reading the key")?;
                tls = tls.client_cert(Some(ClientCert::new_with_certs(&certificates(&certificate)?, key)));
            }
        } else {
            // Refuses what the vehicles' port would refuse, too.
            self.endpoint(url)?;
        }
        let bearer = self.token.as_ref().map(|token| format!("Bearer {}", token.trim()));
        let bearer = bearer.map(|bearer| ureq::http::HeaderValue::from_str(&bearer)).transpose();
        let bearer = bearer.context("the token holds characters that no token has")?;
        let config = ureq::Agent::config_builder()
            .timeout_global(Some(patience))
            // A refusal has a body, with its reason.
            .http_status_as_error(false)
            // A token goes to the service that was named, and to no other.
            .max_redirects(0)
            .tls_config(tls.build())
            .middleware(
                move |mut request: ureq::http::Request<ureq::SendBody>,
                      next: ureq::middleware::MiddlewareNext| {
                    if let Some(bearer) = &bearer {
                        request.headers_mut().insert("authorization", bearer.clone());
                    }
                    next.handle(request)
                },
            );
        Ok(config.build().into())
    }

    fn identity(&self) -> anyhow::Result<Option<(String, String)>> {
        match (&self.cert, &self.key) {
            (Some(certificate), Some(key)) => Ok(Some((read(certificate)?, read(key)?))),
            (None, None) => Ok(None),
            _ => bail!("a certificate and its key go together: give both --cert and --key"),
        }
    }
}

fn read(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))
}

fn certificates(pem: &str) -> anyhow::Result<Vec<Certificate<'static>>> {
    let mut found = Vec::new();
    for item in parse_pem(pem.as_bytes()) {
        if let PemItem::Certificate(certificate) = item.context("reading a certificate")? {
            found.push(certificate);
        }
    }
    anyhow::ensure!(!found.is_empty(), "the file holds no certificate in PEM");
    Ok(found)
}

//! A service that asks who calls, and its callers.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use echofix_client::service::CallerChannel;
use echofix_harness::credentials::Credentials;
use echofix_harness::process::{Launch, ServiceProcess};
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_server::identity::tokens;
use echofix_tests::{binary, until_blocking};
use tempfile::TempDir;
use tonic::{Code, Request, Status, Streaming};
use tonic_health::pb::health_client::HealthClient;
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};
use tonic_prost::ProstCodec;

use super::authority::{Authority, Certified};
use super::calls::{Call, ROLES};
use super::issuer::Issuer;

/// A busy machine takes its time.
const PATIENCE: Duration = Duration::from_mins(1);

/// What came of a call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The handler answered, whatever it said.
    Admitted,
    Unauthenticated,
    Forbidden,
    /// There is no connection.
    NotLetIn,
    /// The method is answered by nothing.
    NotServed,
}

/// A service, and everybody who calls it.
pub struct Site {
    folder: TempDir,
    authority: Authority,
    issuer: Issuer,
    /// Roles' tokens.
    tokens: Vec<(&'static str, String)>,
    certified: Vec<(&'static str, Certified)>,
    revoked: Mutex<Vec<u64>>,
    versions: AtomicU32,
    ca: PathBuf,
    _process: ServiceProcess,
    pub grpc: String,
    pub http: String,
}

/// Somebody who calls.
pub struct Caller {
    pub who: String,
    channel: CallerChannel,
    agent: ureq::Agent,
    headers: Vec<(String, String)>,
}

impl Site {
    /// A service with certificates, a list of revoked ones, and tokens, one of each role.
    pub fn start() -> Self {
        Self::start_with(&[])
    }

    /// The same with more settings.
    pub fn start_with(more: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let first = folder.path().join("v1");
        fs::create_dir(&first).unwrap();
        let authority = Authority::new();
        let service = authority.service();
        let write = |name: &str, text: &str| fs::write(first.join(name), text).unwrap();
        write("server.pem", &service.pem);
        write("server.key", &service.key);
        write("ca.pem", authority.pem());
        write("crl.pem", &authority.revoked(&[99]));
        let issuer = Issuer::new("k1");
        write("jwks.json", &issuer.set());
        let token = |role: &'static str| {
            let name = format!("{role}-1");
            (role, tokens::create(&first.join("tokens"), role.parse().unwrap(), &name).unwrap())
        };
        let tokens = ROLES.map(token).to_vec();
        let certify = |(role, serial): (&'static str, u64)| {
            (role, authority.caller(&[format!("echofix://{role}/{role}-1")], serial, false))
        };
        let certified = ROLES.into_iter().zip(10..).map(certify).collect();
        symlink("v1", folder.path().join("current")).unwrap();
        let at = |name: &str| folder.path().join("current").join(name).display().to_string();
        let mut settings = vec![
            format!("tls.certificate={}", at("server.pem")),
            format!("tls.key={}", at("server.key")),
            format!("tls.client_ca={}", at("ca.pem")),
            format!("tls.crl={}", at("crl.pem")),
            format!("identity.tokens={}", at("tokens")),
            "tls.reload_s=1".to_owned(),
        ];
        settings.extend(Issuer::settings(&at("jwks.json")));
        settings.extend(more.iter().map(|&setting| setting.to_owned()));
        let ca = first.join("ca.pem");
        Self { issuer, tokens, certified, ..Self::launch(folder, authority, settings, ca, "https") }
    }

    /// A service with the configuration that the command printed.
    pub fn configured(configuration: &str, ca: &str) -> Self {
        let settings = configuration.lines().filter_map(|line| line.split_once(" = "));
        let settings =
            settings.map(|(key, value)| format!("tls.{key}={}", value.trim_matches('"'))).collect();
        Self::launch(tempfile::tempdir().unwrap(), Authority::new(), settings, ca.into(), "https")
    }

    /// A service that takes a header's word, unencrypted.
    pub fn behind_a_proxy(header: &str, more: &[&str]) -> Self {
        let mut settings = vec![format!("identity.proxy_header={header}")];
        settings.extend(more.iter().map(|&setting| setting.to_owned()));
        Self::launch(tempfile::tempdir().unwrap(), Authority::new(), settings, PathBuf::new(), "http")
    }

    /// A service that believes the keys at an address, unencrypted.
    pub fn of_issuer(url: &str) -> Self {
        Self::plain(Issuer::settings(url))
    }

    /// A service with these settings, unencrypted.
    pub fn plain(settings: Vec<String>) -> Self {
        Self::launch(tempfile::tempdir().unwrap(), Authority::new(), settings, PathBuf::new(), "http")
    }

    fn launch(
        folder: TempDir,
        authority: Authority,
        mut settings: Vec<String>,
        ca: PathBuf,
        scheme: &str,
    ) -> Self {
        settings.push("mapping.publish_contributors=1".to_owned());
        let launch = Launch {
            program: binary::echofix(),
            folder: folder.path(),
            data_dir: &folder.path().join("data"),
            settings,
            variables: Vec::new(),
        };
        let mut process = ServiceProcess::launch(&launch).unwrap();
        until_blocking("the service listens", PATIENCE, || {
            assert!(process.ended().unwrap().is_none(), "the service did not start:\n{}", process.log());
            process.listens().then_some(())
        });
        let at = |url: &str| url.replacen("http", scheme, 1);
        let (grpc, http) = (at(&process.grpc), at(&process.http));
        let site = Self {
            folder,
            authority,
            issuer: Issuer::new("none"),
            tokens: Vec::new(),
            certified: Vec::new(),
            revoked: Mutex::new(vec![99]),
            versions: AtomicU32::new(1),
            ca,
            _process: process,
            grpc,
            http,
        };
        // Lazy connections need a runtime; probes do not.
        let agent = site.credentials().agent(&site.http, PATIENCE).unwrap();
        until_blocking("the service is ready", PATIENCE, || {
            let ready = agent.get(format!("{}/readyz", site.http)).call().is_ok_and(|a| a.status() == 200);
            ready.then_some(())
        });
        site
    }

    fn credentials(&self) -> Credentials {
        let encrypted = self.http.starts_with("https");
        Credentials { ca: encrypted.then(|| self.ca.clone()), ..Credentials::default() }
    }

    /// The file of the authority.
    pub fn ca(&self) -> &Path {
        &self.ca
    }

    /// Certificate and key of a role, as files.
    pub fn certificate_files(&self, role: &str) -> (PathBuf, PathBuf) {
        let (_, certified) = self.certified.iter().find(|(known, _)| *known == role).unwrap();
        self.written(role, certified)
    }

    /// Who shows the certificate of a role.
    pub fn certified(&self, role: &str) -> Caller {
        let (_, certified) = self.certified.iter().find(|(known, _)| *known == role).unwrap();
        self.showing(&format!("certificate of {role}"), certified)
    }

    /// Who shows a good certificate with these URIs.
    pub fn certified_as(&self, who: &str, uris: &[&str]) -> Caller {
        let uris: Vec<_> = uris.iter().map(|&uri| uri.to_owned()).collect();
        self.showing(who, &self.authority.caller(&uris, 50, false))
    }

    /// Those whose certificates are no good: expired, of another authority, revoked.
    pub fn impostors(&self) -> Vec<Caller> {
        let uris = ["echofix://admin/a".to_owned()];
        let other = Authority::new();
        vec![
            self.showing("expired", &self.authority.caller(&uris, 60, true)),
            self.showing("of another authority", &other.caller(&uris, 61, false)),
            self.showing("revoked", &self.authority.caller(&uris, 99, false)),
        ]
    }

    fn showing(&self, who: &str, certified: &Certified) -> Caller {
        let (cert, key) = self.written(who, certified);
        let credentials = Credentials { cert: Some(cert), key: Some(key), ..self.credentials() };
        Caller::with(self, who, &credentials, Vec::new())
    }

    fn written(&self, who: &str, certified: &Certified) -> (PathBuf, PathBuf) {
        let file = |ending: &str| self.folder.path().join(format!("{}.{ending}", who.replace(' ', "-")));
        fs::write(file("pem"), &certified.pem).unwrap();
        fs::write(file("key"), &certified.key).unwrap();
        (file("pem"), file("key"))
    }

    /// Who brings the token of a role.
    pub fn with_token(&self, role: &str) -> Caller {
        Caller::token(self, &format!("token of {role}"), &self.token(role))
    }

    /// Who brings an issuer's token that stands for a role.
    pub fn with_jwt(&self, role: &str) -> Caller {
        // Every other one by the other algorithm.
        let token = if role.len().is_multiple_of(2) {
            self.issuer.token(role)
        } else {
            self.issuer.other_token(role)
        };
        Caller::token(self, &format!("issuer's token of {role}"), &token)
    }

    /// Who brings an issuer's token that is no good.
    pub fn bad_jwts(&self) -> Vec<Caller> {
        let bad = self.issuer.bad_tokens().into_iter();
        bad.map(|(who, token)| Caller::token(self, &format!("issuer's token: {who}"), &token)).collect()
    }

    /// The token of a role.
    pub fn token(&self, role: &str) -> String {
        self.tokens.iter().find(|(known, _)| *known == role).unwrap().1.clone()
    }

    /// Puts the certificate of a role on the list of revoked ones.
    pub fn revoke(&self, role: &str) {
        let serial = self.certified.iter().find(|(known, _)| *known == role).unwrap().1.serial;
        let mut revoked = self.revoked.lock().unwrap();
        revoked.push(serial);
        self.replace("crl.pem", |_| self.authority.revoked(&revoked));
    }

    /// Removes the token of a role from the file.
    pub fn withdraw_token(&self, role: &str) {
        let of_role = |line: &&str| !line.contains(&format!(" {role}-1 "));
        self.replace("tokens", |text| text.lines().filter(of_role).flat_map(|line| [line, "\n"]).collect());
    }

    /// Breaks the certificate.
    pub fn break_files(&self) {
        self.replace("server.pem", |text| text[..text.len() / 2].to_owned());
    }

    /// Makes a new version of all files, of which one is different, and lets the link lead there, as clusters mount secrets.
    fn replace(&self, name: &str, change: impl FnOnce(String) -> String) {
        let version = self.versions.fetch_add(1, Ordering::Relaxed);
        let (old, new) = (format!("v{version}"), format!("v{}", version + 1));
        let (from, to) = (self.folder.path().join(old), self.folder.path().join(&new));
        fs::create_dir(&to).unwrap();
        for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
            fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
        let text = fs::read_to_string(to.join(name)).unwrap();
        fs::write(to.join(name), change(text)).unwrap();
        symlink(new, self.folder.path().join("next")).unwrap();
        fs::rename(self.folder.path().join("next"), self.folder.path().join("current")).unwrap();
    }

    /// Makes a call and says what came of it.
    pub async fn outcome(&self, caller: &Caller, call: &Call) -> Outcome {
        if call.method.is_empty() {
            return rpc(caller.channel.clone(), &call.path).await;
        }
        let parameters = [
            ("{layer}", "evidence"),
            ("{name}", "none"),
            ("{hash}", "0000000000000000"),
            ("{id}", "00000000-0000-0000-0000-000000000000"),
            ("{epsg}", "32614"),
            ("{z}", "0"),
            ("{x}", "0"),
            ("{y}", "0.png"),
        ];
        let path = parameters.iter().fold(call.path.clone(), |path, (name, value)| path.replace(name, value));
        tokio::task::block_in_place(|| match caller.send(self, &call.method, &path, "", &[]) {
            Err(_) => Outcome::NotLetIn,
            Ok(answer) => match answer.status().as_u16() {
                401 => Outcome::Unauthenticated,
                403 => Outcome::Forbidden,
                405 => Outcome::NotServed,
                _ => Outcome::Admitted,
            },
        })
    }
}

async fn rpc(channel: CallerChannel, path: &str) -> Outcome {
    let mut client = tonic::client::Grpc::new(channel);
    if client.ready().await.is_err() {
        return Outcome::NotLetIn;
    }
    let codec = ProstCodec::<(), ()>::default();
    let called = client.server_streaming(Request::new(()), path.parse().unwrap(), codec);
    let status = match tokio::time::timeout(PATIENCE, called).await.expect("every call is answered") {
        Ok(answers) => tokio::time::timeout(PATIENCE, answers.into_inner().message()).await.unwrap().err(),
        Err(status) => Some(status),
    };
    status.map_or(Outcome::Admitted, |status: Status| match status.code() {
        Code::Unauthenticated => Outcome::Unauthenticated,
        Code::PermissionDenied => Outcome::Forbidden,
        Code::Unimplemented => Outcome::NotServed,
        // What no service said.
        _ if std::error::Error::source(&status).is_some() => Outcome::NotLetIn,
        _ => Outcome::Admitted,
    })
}

impl Caller {
    fn with(site: &Site, who: &str, credentials: &Credentials, headers: Vec<(String, String)>) -> Self {
        Self {
            who: who.to_owned(),
            channel: credentials.endpoint(&site.grpc).unwrap().connect_lazy(),
            agent: credentials.agent(&site.http, PATIENCE).unwrap(),
            headers,
        }
    }

    /// Who shows nothing.
    pub fn nobody(site: &Site) -> Self {
        Self::with(site, "nobody", &site.credentials(), Vec::new())
    }

    /// Who brings a token.
    pub fn token(site: &Site, who: &str, token: &str) -> Self {
        let credentials = Credentials { token: Some(token.to_owned()), ..site.credentials() };
        Self::with(site, who, &credentials, Vec::new())
    }

    /// A browser with this cookie.
    pub fn cookie(site: &Site, cookie: &str) -> Self {
        Self::header(site, "cookie", cookie)
    }

    /// Who brings a header to the operators' port.
    pub fn header(site: &Site, name: &str, value: &str) -> Self {
        Self::with(site, value, &site.credentials(), vec![(name.to_owned(), value.to_owned())])
    }

    pub fn channel(&self) -> CallerChannel {
        self.channel.clone()
    }

    /// A client that contributes.
    pub fn mapping(&self) -> MappingServiceClient<CallerChannel> {
        MappingServiceClient::new(self.channel())
    }

    /// Follows the service's health, which is open to all as long as the connection is.
    pub async fn watch_health(&self) -> Streaming<HealthCheckResponse> {
        let request = HealthCheckRequest { service: String::new() };
        HealthClient::new(self.channel()).watch(request).await.unwrap().into_inner()
    }

    /// A body.
    pub fn get(&self, site: &Site, path: &str) -> String {
        let mut answer = self.send(site, "GET", path, "", &[]).unwrap();
        answer.body_mut().read_to_string().unwrap()
    }

    pub fn status(&self, site: &Site, path: &str) -> u16 {
        self.send(site, "GET", path, "", &[]).unwrap().status().as_u16()
    }

    /// An answer, whatever it is.
    pub fn answer(&self, site: &Site, path: &str) -> ureq::http::Response<ureq::Body> {
        self.ask(site, "GET", path, &[])
    }

    /// The same with a method and headers.
    pub fn ask(
        &self,
        site: &Site,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
    ) -> ureq::http::Response<ureq::Body> {
        let body = if method == "POST" { "{}" } else { "" };
        self.send(site, method, path, body, headers).unwrap()
    }

    /// Status and the cookie that was set.
    pub fn post(&self, site: &Site, path: &str, body: &str, headers: &[(&str, &str)]) -> (u16, String) {
        let answer = self.send(site, "POST", path, body, headers).unwrap();
        let cookie = answer.headers().get("set-cookie").map_or("", |cookie| cookie.to_str().unwrap());
        (answer.status().as_u16(), cookie.to_owned())
    }

    fn send(
        &self,
        site: &Site,
        method: &str,
        path: &str,
        body: &str,
        headers: &[(&str, &str)],
    ) -> Result<ureq::http::Response<ureq::Body>, ureq::Error> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", site.http));
        let own = self.headers.iter().map(|(name, value)| (name.as_str(), value.as_str()));
        for (name, value) in own.chain(headers.iter().copied()) {
            request = request.header(name, value);
        }
        if method != "POST" {
            return self.agent.run(request.body(()).unwrap());
        }
        self.agent.run(request.header("content-type", "application/json").body(body.to_owned()).unwrap())
    }
}

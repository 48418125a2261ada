//! The operators' port behind a proxy that shows it below a path of another name, and asked by pages of other origins.

use echofix_tests::http::{Answer, get_with, send};
use echofix_tests::service::Service;

/// How a browser sees the port.
const OUTSIDE: &str = "https://maps.example/echofix/";
const PAGE: &str = "https://fleet.example";

/// A proxy in front of the service, as `OUTSIDE`.
struct Proxy<'a> {
    service: &'a Service,
    /// Whether it takes `/echofix` off.
    strips: bool,
    headers: Vec<(&'static str, &'static str)>,
}

impl Proxy<'_> {
    /// What a browser gets under an address.
    fn browse(&self, url: &str) -> Answer {
        let path =
            url.strip_prefix("https://maps.example").unwrap_or_else(|| panic!("{url} leads elsewhere"));
        let below = path.strip_prefix("/echofix").unwrap_or_else(|| panic!("{url} is not the proxy's"));
        let below = if below.starts_with('/') { below.to_owned() } else { format!("/{below}") };
        let path = if self.strips { below } else { path.to_owned() };
        get_with(&format!("{}{path}", self.service.http), &self.headers)
    }
}

/// An address of a page as a browser resolves it: against the base that the page names, or its own address.
fn resolved(page: &str, own: &str, link: &str) -> String {
    let base = page.split("<base href=\"").nth(1).and_then(|rest| rest.split('"').next());
    let base = base.map_or_else(|| own.to_owned(), |path| format!("https://maps.example{path}"));
    assert!(
        !link.starts_with('/') && !link.contains("://"),
        "{link} leaves the path below which the page is shown"
    );
    format!("{}/{link}", base.rsplit_once('/').expect("an address has a slash").0)
}

fn see_it_whole(proxy: &Proxy, first: &str) {
    let page = proxy.browse(first);
    assert_eq!(page.status, 200, "{first}");
    let text = page.text();
    let links = text.split(['"']).filter(|part| {
        ["assets/", "openapi.json", "metrics", "tiles/"]
            .iter()
            .any(|start| part.starts_with(start) || part[..].starts_with(&format!("/{start}")))
    });
    let links: Vec<_> = links.collect();
    assert!(links.len() >= 6, "{links:?}");
    for link in &links {
        let url = resolved(text, first, link);
        assert_eq!(proxy.browse(&url).status, 200, "{url}");
    }
    let script = links.iter().find(|link| link.contains(".js")).expect("the page has a script");
    let script = proxy.browse(&resolved(text, first, script));
    for rooted in ["\"/api/", "`/api/", "'/api/", "\"/assets/", "\"/session\"", "`/tiles/"] {
        assert!(
            !script.text().contains(rooted),
            "the script asks for {rooted}, whatever path it is shown below"
        );
    }
    let tiles = proxy.browse(&format!("{OUTSIDE}tiles/age.json")).json()["tiles"][0]
        .as_str()
        .expect("TileJSON names tiles")
        .to_owned();
    assert!(tiles.starts_with(&format!("{OUTSIDE}tiles/age/")), "{tiles}");
    let picture = tiles.replace("{z}", "3").replace("{x}", "1").replace("{y}", "2");
    assert_eq!(proxy.browse(&picture).header("content-type"), Some("image/png"), "{picture}");
}

/// Catches: a console whose files or data lie at the root of a name that is shared with other programs, and descriptions whose
/// addresses lead nowhere.
#[test]
fn the_port_is_whole_below_a_path_of_another_name() {
    let service = Service::start_with(&["http.base_path=/echofix", "http.hosts=[\"maps.example\"]"]);
    let lists = vec![("x-forwarded-host", "maps.example, inner"), ("x-forwarded-proto", "https, http")];
    let standard = vec![("forwarded", "for=10.0.0.7;host=maps.example;proto=https, for=127.0.0.1")];
    for (strips, headers) in [(false, lists.clone()), (true, lists), (true, standard)] {
        let proxy = Proxy { service: &service, strips, headers };
        // Also without the slash at its end.
        for first in [OUTSIDE, OUTSIDE.trim_end_matches('/')] {
            see_it_whole(&proxy, first);
        }
    }
    // Nothing configured but the name: the proxy tells the path itself, or a browser resolves what is relative.
    let service = Service::start_with(&["http.hosts=[\"maps.example\"]"]);
    let told =
        vec![("host", "maps.example"), ("x-forwarded-proto", "https"), ("x-forwarded-prefix", "/echofix")];
    see_it_whole(&Proxy { service: &service, strips: true, headers: told }, OUTSIDE);
    // A name that is not the port's stands in no address.
    let foreign =
        get_with(&format!("{}/tiles/age.json", service.http), &[("x-forwarded-host", "evil.example")]);
    assert!(!foreign.text().contains("evil.example"), "{}", foreign.text());
}

/// Catches: a sign-in or a decision of the console that is refused because the proxy asks by another name.
#[test]
fn the_console_decides_through_a_proxy_and_strangers_do_not() {
    let service = Service::start_with(&["http.hosts=[\"maps.example\"]"]);
    let out = |origin: &str| {
        let headers = [("x-forwarded-host", "maps.example"), ("origin", origin)];
        send("DELETE", &format!("{}/session", service.http), &headers)
    };
    let own = out("https://maps.example");
    assert_eq!(own.status, 204);
    assert!(own.header("set-cookie").unwrap().contains("Path=/;"));
    let foreign = out(PAGE);
    assert_eq!(foreign.status, 403);
    assert!(foreign.json()["error"]["message"].as_str().unwrap().contains("http.cors_origins"));
}

/// Catches: a page of a listed origin that cannot read the map, a preflight that is asked who asks, and any other page that may.
#[test]
fn pages_of_listed_origins_may_ask_and_no_others() {
    let tokens = tempfile::tempdir().unwrap();
    let file = tokens.path().join("tokens");
    let token =
        echofix_server::identity::tokens::create(&file, "viewer".parse().unwrap(), "viewer-1").unwrap();
    let tokens = format!("identity.tokens={}", file.display());
    let service = Service::start_with(&[&tokens, &format!("http.cors_origins=[\"{PAGE}\"]")]);
    let bearer = format!("Bearer {token}");
    let preflight = |origin: &str, method: &str| {
        let asks =
            [("access-control-request-method", method), ("access-control-request-headers", "authorization")];
        let headers = [&[("origin", origin)][..], &asks].concat();
        send("OPTIONS", &format!("{}/api/v1/map", service.http), &headers)
    };
    let may = preflight(PAGE, "GET");
    assert_eq!((may.status, may.header("access-control-allow-origin")), (200, Some(PAGE)));
    assert_eq!(may.header("access-control-allow-credentials"), Some("true"));
    assert!(may.header("access-control-allow-headers").unwrap().contains("authorization"));
    assert!(may.header("access-control-allow-methods").unwrap().contains("POST"));
    assert_eq!(preflight("https://evil.example", "GET").header("access-control-allow-origin"), None);
    let read = |path: &str, origin: &str| {
        let headers = [("origin", origin), ("sec-fetch-site", "cross-site"), ("authorization", &bearer)];
        get_with(&format!("{}{path}", service.http), &headers)
    };
    for path in ["/api/v1/map", "/tiles/age.json", "/tiles/age/3/1/2.png"] {
        let answer = read(path, PAGE);
        assert_eq!(
            (answer.status, answer.header("access-control-allow-origin")),
            (200, Some(PAGE)),
            "{path}"
        );
        let exposed = answer.header("access-control-expose-headers").unwrap();
        assert!(exposed.contains("etag") && exposed.contains("x-request-id"), "{exposed}");
        assert_eq!(read(path, "https://evil.example").header("access-control-allow-origin"), None, "{path}");
    }
    assert_eq!(read("/api/v1/map", "https://evil.example").status, 403);
    // Listed or not, a page's caller needs the role: this one is only a viewer, who may sign out and decide nothing.
    let headers = [("origin", PAGE), ("sec-fetch-site", "cross-site"), ("authorization", &bearer)];
    assert_eq!(send("DELETE", &format!("{}/session", service.http), &headers).status, 204);
    assert_eq!(read("/api/v1/map/backup", PAGE).json()["error"]["code"], "role_missing");
}

/// Catches: a star that lets any page decide, or read backups and fixes of a service that asks nobody.
#[test]
fn a_star_lets_all_pages_read_what_viewers_read() {
    let service = Service::start_with(&["http.cors_origins=[\"*\"]"]);
    let page = [("origin", PAGE)];
    let ask = |method: &str, path: &str| send(method, &format!("{}{path}", service.http), &page);
    for path in ["/api/v1/map", "/tiles/age.json"] {
        let answer = ask("GET", path);
        assert_eq!(answer.status, 200, "{path}");
        assert!(["*", PAGE].contains(&answer.header("access-control-allow-origin").unwrap()), "{path}");
        assert_eq!(answer.header("access-control-allow-credentials"), None, "{path}");
    }
    for path in ["/api/v1/map/backup", "/api/v1/fixes", "/api/v1/map/verify"] {
        assert_eq!(ask("GET", path).json()["error"]["code"], "wrong_origin", "{path}");
    }
    assert_eq!(ask("DELETE", "/session").json()["error"]["code"], "wrong_origin");
    let preflight = send(
        "OPTIONS",
        &format!("{}/api/v1/map/rollback", service.http),
        &[("origin", PAGE), ("access-control-request-method", "POST")],
    );
    assert!(!preflight.header("access-control-allow-methods").unwrap().contains("POST"));
}

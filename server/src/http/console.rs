//! The page an operator looks at, embedded in the binary by the build script. Without the feature `console` a plain page
//! stands in its place.

use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};

use super::App;
use super::answers::ErrorAnswer;
use super::base_map::BaseMap;
use super::error::Error;
use super::outside::Outside;

#[cfg(feature = "console")]
include!(concat!(env!("OUT_DIR"), "/console_assets.rs"));

#[cfg(not(feature = "console"))]
static ASSETS: [Asset; 1] = [Asset { name: "index.html", plain: NOT_BUILT_IN, gzip: None }];

/// What stands for the console in a service that was built without it.
#[cfg(not(feature = "console"))]
const NOT_BUILT_IN: &[u8] = br#"<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Echofix</title>
<p>The console is not built into this service: it was compiled without the feature <code>console</code>.
<p>What it would show is described in <a href="openapi.json">openapi.json</a>.
</html>
"#;

/// A file of the console.
struct Asset {
    name: &'static str,
    plain: &'static [u8],
    /// The same, compressed; absent where that gains nothing.
    gzip: Option<&'static [u8]>,
}

/// Only our own scripts, styles and data, and the base map's tiles; no frame may show the page.
pub(super) fn policy(base_map: Option<&BaseMap>) -> HeaderValue {
    let tiles = base_map.and_then(BaseMap::origin).map(|origin| format!(" {origin}")).unwrap_or_default();
    let policy = format!(
        "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src 'self' data: blob:{tiles}; \
         connect-src 'self'{tiles}; font-src 'self'; manifest-src 'self'; base-uri 'self'; form-action 'none'; \
         frame-ancestors 'none'"
    );
    // An origin is made of what a header may hold; without a policy nothing is loaded.
    HeaderValue::from_str(&policy).unwrap_or(HeaderValue::from_static("default-src 'none'"))
}

/// `GET /`. All that the page names is relative to it; where it is known under which path a proxy shows it, that is said, too:
/// the browser may have asked for it without the slash at the end.
#[utoipa::path(
    get,
    path = "/",
    operation_id = "getConsole",
    tag = "console",
    summary = "The console.",
    description = "",
    responses(
        (status = 200, description = "The page.", body = String, content_type = "text/html"),
    )
)]
pub async fn page(
    State(app): State<Arc<App>>,
    Extension(outside): Extension<Outside>,
    headers: HeaderMap,
) -> Result<Response, Error> {
    if outside.prefix.is_empty() {
        return serve(&app, "index.html", "no-cache", &headers);
    }
    let mut response = serve(&app, "index.html", "no-cache", &HeaderMap::new())?;
    // A prefix is made of letters, digits and `/-_.~`: none ends the attribute.
    let based = format!("<meta charset=\"utf-8\">\n<base href=\"{}/\">", outside.prefix);
    *response.body_mut() = plain("index.html")?.replacen("<meta charset=\"utf-8\">", &based, 1).into();
    Ok(response)
}

/// `GET /assets/{name}`: the name holds a hash of the content.
#[utoipa::path(
    get,
    path = "/assets/{name}",
    operation_id = "getAsset",
    tag = "console",
    summary = "A file of the console.",
    description = "",
    params(("name" = String, Path, description = "Its name, which holds a hash of the content.")),
    responses(
        (status = 200, description = "The file.", body = Vec<u8>, content_type = "*/*"),
        (status = 404, description = "No such file.", body = ErrorAnswer),
    )
)]
pub async fn asset(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Error> {
    serve(&app, &format!("assets/{name}"), "public, max-age=31536000, immutable", &headers)
}

/// The text of a file.
fn plain(name: &str) -> Result<Cow<'static, str>, Error> {
    Ok(String::from_utf8_lossy(asset_of(name)?.plain))
}

fn asset_of(name: &str) -> Result<&'static Asset, Error> {
    let missing = || Error::NotFound(format!("the console has no file `{name}`"));
    ASSETS.iter().find(|asset| asset.name == name).ok_or_else(missing)
}

fn serve(app: &App, name: &str, caching: &'static str, headers: &HeaderMap) -> Result<Response, Error> {
    let asset = asset_of(name)?;
    let fixed = HeaderValue::from_static;
    let common = [
        (header::CONTENT_TYPE, fixed(content_type(name))),
        (header::CACHE_CONTROL, fixed(caching)),
        (header::VARY, fixed("accept-encoding")),
        (header::CONTENT_SECURITY_POLICY, app.page_policy.clone()),
        (header::X_FRAME_OPTIONS, fixed("DENY")),
    ];
    Ok(match asset.gzip.filter(|_| accepts_gzip(headers)) {
        Some(gzip) => (common, [(header::CONTENT_ENCODING, "gzip")], gzip).into_response(),
        None => (common, asset.plain).into_response(),
    })
}

fn accepts_gzip(headers: &HeaderMap) -> bool {
    let given = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    given.flat_map(|list| list.split(',')).any(|coding| {
        let mut parts = coding.split(';').map(str::trim);
        let name = parts.next().unwrap_or_default();
        let refused = parts.any(|p| p.strip_prefix("q=").is_some_and(|q| q.parse() == Ok(0.0_f32)));
        name.eq_ignore_ascii_case("gzip") && !refused
    })
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "map" => "application/json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "woff2" => "font/woff2",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    #[cfg(feature = "console")]
    use super::*;
    use crate::http::testing::{TestSite, bytes_of};
    #[cfg(feature = "console")]
    use axum::http::Method;

    #[cfg(not(feature = "console"))]
    #[tokio::test]
    async fn a_plain_page_says_that_there_is_no_console() {
        let response = TestSite::default().get("/").await;
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/html; charset=utf-8");
        assert!(bytes_of(response).await.windows(12).any(|part| part == b"not built in"));
        assert_eq!(TestSite::default().get("/assets/none.js").await.status(), 404);
    }

    #[tokio::test]
    async fn the_page_allows_only_what_it_brings() {
        let response = TestSite::default().get("/").await;
        let policy = response.headers()["content-security-policy"].to_str().unwrap();
        assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(response.headers()["content-type"], "text/html; charset=utf-8");
        assert_eq!(response.headers()["cache-control"], "no-cache");
        let page = String::from_utf8(bytes_of(response).await.to_vec()).unwrap();
        assert!(page.contains("Echofix") && !page.contains("=\"http") && !page.contains("<style"), "{page}");
    }

    #[cfg(feature = "console")]
    #[tokio::test]
    async fn everything_the_page_names_is_served() {
        let site = TestSite::default();
        let page = String::from_utf8(bytes_of(site.get("/").await).await.to_vec()).unwrap();
        let named: Vec<_> = page.split('"').filter(|part| part.starts_with("assets/")).collect();
        assert!(
            ["text/javascript", "text/css"]
                .iter()
                .all(|kind| named.iter().any(|n| content_type(n).starts_with(kind))),
            "{named:?}"
        );
        for path in named {
            let response = site.get(&format!("/{path}")).await;
            assert_eq!(response.status(), 200, "{path}");
            assert!(response.headers()["cache-control"].to_str().unwrap().contains("immutable"));
            assert!(response.headers().contains_key("content-security-policy"));
        }
        assert_eq!(site.get("/assets/none.js").await.status(), 404);
        assert_eq!(site.get("/assets/..%2Findex.html").await.status(), 404);
    }

    #[cfg(feature = "console")]
    #[tokio::test]
    async fn what_compresses_is_sent_compressed_to_whoever_accepts_it() {
        let site = TestSite::default();
        let script = ASSETS.iter().find(|a| content_type(a.name).starts_with("text/javascript")).unwrap();
        let path = format!("/{}", script.name);
        let response = site.send(Method::GET, &path, &[("accept-encoding", "br, gzip;q=0.5")]).await;
        assert_eq!(response.headers()["content-encoding"], "gzip");
        assert!(bytes_of(response).await.len() < script.plain.len() / 2);
        for refusing in ["", "br", "gzip;q=0"] {
            let response = site.send(Method::GET, &path, &[("accept-encoding", refusing)]).await;
            assert!(!response.headers().contains_key("content-encoding"), "{refusing}");
            assert_eq!(bytes_of(response).await, script.plain);
        }
    }
}

//! The description of these routes: made from the handlers, the types they answer with, and the table of who may ask what.

use std::sync::LazyLock;

use axum::extract::Extension;
use axum::http::header;
use axum::response::IntoResponse;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::security::{ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, Ref, Response, ResponseBuilder, SecurityRequirement, extensions::ExtensionsBuilder,
};
use utoipa::{Modify, OpenApi};

use super::answers::MissedEvent;
use super::outside::Outside;
use super::{
    base_map, catalog, cells, console, contributors, decisions, expectation, files, layers, live, operations,
    probes, quarantine, session, sign_in,
};
use crate::feed::QuarantineEvent;
use crate::identity::COOKIE;
use crate::identity::access::{self, Access, Call};

/// Where the least role of an operation stands.
const LEAST_ROLE: &str = "x-least-role";
/// What the addresses of the document are relative to, until somebody asks for it.
const HERE: &str = "/";

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Echofix for operators",
        description = "Map layers, the catalog, the map's history and what is decided about it, the feeds, health and metrics. \
            Vehicles use gRPC instead.\n\nEvery answer names its request in the header `x-request-id`: the caller's id, where it \
            has 1 to 64 visible ASCII characters, else a fresh one; the log's lines carry it. A request that carries \
            `traceparent` (W3C Trace Context) is part of that trace. GET also answers HEAD.\n\nWhere the service asks who calls, a \
            request brings a client certificate, `authorization: Bearer TOKEN` or the cookie of a session, or comes through a \
            proxy that says who it is. Which role an operation takes at least, `x-least-role` says."
    ),
    servers((url = "/", description = "This service.")),
    tags(
        (name = "map", description = "The map in numbers."),
        (name = "tiles", description = "Tiles in numbers, and as pictures."),
        (name = "history", description = "What happened to the map, and what vetting kept out of it."),
        (name = "decisions", description = "What operators decide about the map. Each decision but compacting can be undone."),
        (name = "files", description = "Regions out and in, backups, and whether what is stored is sound."),
        (name = "feeds", description = "The last fixes and uploads, and the stream of new ones."),
        (name = "service", description = "Alive, ready, counted."),
        (name = "session", description = "Browsers sign in and out."),
        (name = "console", description = "The page for operators."),
    ),
    paths(
        catalog::map, catalog::tile_at, catalog::tile, cells::cells, cells::cell_at, expectation::tile, layers::tilejson, layers::tile,
        operations::history, operations::diff, operations::verify, operations::verify_with_replay, quarantine::quarantine,
        contributors::contributors, contributors::uploads, contributors::upload,
        decisions::rollback, decisions::revoke, decisions::undo, decisions::compact, decisions::settle,
        files::export, files::import, files::backup, live::fixes, live::uploads, live::events,
        probes::healthz, probes::readyz, probes::metrics, session::who, session::sign_in, session::sign_out,
        sign_in::ways, sign_in::begin, sign_in::finish,
        document, console::page, console::asset, base_map::described, base_map::file,
    ),
    // Events of the stream, which no operation names.
    components(schemas(MissedEvent, QuarantineEvent)),
    modifiers(&Common),
)]
struct Description;

/// What holds for all operations, or follows from who may ask for them.
struct Common;

impl Modify for Common {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let schemes = [
            ("token", bearer()),
            (
                "session",
                SecurityScheme::ApiKey(ApiKey::Cookie(ApiKeyValue::with_description(COOKIE, SESSION))),
            ),
            (
                "certificate",
                SecurityScheme::MutualTls {
                    description: Some(CERTIFICATE.to_owned()),
                    extensions: None,
                    deprecated: None,
                },
            ),
        ];
        let components = document.components.get_or_insert_default();
        components.security_schemes.extend(schemes.map(|(name, scheme)| (name.to_owned(), scheme.into())));
        for (path, item) in &mut document.paths.paths {
            for (method, operation) in operations_of(item) {
                if let Some(access) = access::of(Call::Http(method, &route_of(path))) {
                    described(operation, path, access);
                }
            }
        }
    }
}

const SESSION: &str = "The cookie that signing in gives to a browser. What changes anything also takes the header \
    `x-echofix-csrf`, with what `GET /session` says.";
const CERTIFICATE: &str =
    "A client certificate of the authority in `tls.client_ca`, or one whose fingerprint is listed.";

fn bearer() -> SecurityScheme {
    let described = "A token of `identity.tokens`.";
    SecurityScheme::Http(
        HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(described)).build(),
    )
}

/// The router has no parameters within a segment: the suffix belongs to the description.
fn route_of(path: &str) -> String {
    let ends_in_name =
        |path: &str, suffix| path.strip_suffix(suffix).filter(|rest| rest.ends_with('}')).map(str::to_owned);
    ends_in_name(path, ".json").or_else(|| ends_in_name(path, ".png")).unwrap_or_else(|| path.to_owned())
}

fn operations_of(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    let PathItem { get, post, delete, .. } = item;
    [("GET", get), ("POST", post), ("DELETE", delete)]
        .into_iter()
        .filter_map(|(method, operation)| Some((method, operation.as_mut()?)))
}

/// Says who may ask, and how those are answered who may not.
fn described(operation: &mut Operation, path: &str, access: Access) {
    operation.description = operation.description.take().filter(|text| !text.is_empty());
    let known = || {
        ["token", "session", "certificate"].map(|name| SecurityRequirement::new(name, Vec::<String>::new()))
    };
    let nobody = SecurityRequirement::default();
    let (security, least) = match access {
        Access::Open => (vec![nobody], None),
        Access::Metrics => (known().into_iter().chain([nobody]).collect(), Some("viewer")),
        Access::AnyRole => (known().to_vec(), Some("any")),
        Access::Least(role) => (known().to_vec(), Some(role.name())),
    };
    operation.security = Some(security);
    let responses = &mut operation.responses.responses;
    let mut told = |status: &str, text: &str| {
        responses.entry(status.to_owned()).or_insert_with(|| refusal(text).into());
    };
    if let Some(least) = least {
        let extension = ExtensionsBuilder::new().add(LEAST_ROLE, least).build();
        operation.extensions.get_or_insert_default().merge(extension);
        told("401", "Who asks is not known.");
        told("403", "The caller's role is not enough, or a page of another origin asks.");
    }
    if path != "/healthz" && path != "/readyz" {
        told("429", "The caller, or its address, asks too often; `Retry-After` says when to ask again.");
    }
    told("414", "The address is longer than 1024 bytes.");
    told("default", "Any other refusal or failure.");
}

fn refusal(text: &str) -> Response {
    let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Error"))).build();
    ResponseBuilder::new().description(text).content("application/json", content).build()
}

/// The document, as it is for whoever asks at the root.
pub(super) static DOCUMENT: LazyLock<String> = LazyLock::new(|| {
    // Our own plain structs always have a JSON form.
    Description::openapi().to_pretty_json().unwrap_or_default()
});

/// `GET /openapi.json`, with the address by which the caller sees the port
#[utoipa::path(
    get,
    path = "/openapi.json",
    operation_id = "getDescription",
    tag = "service",
    summary = "This document.",
    description = "",
    responses((status = 200, description = "OpenAPI 3.1.", body = Object)),
)]
pub async fn document(Extension(outside): Extension<Outside>) -> impl IntoResponse {
    let address = outside.address();
    let here = if address.is_empty() { HERE } else { &address };
    let told = DOCUMENT.replacen(&format!("\"url\": \"{HERE}\""), &format!("\"url\": \"{here}\""), 1);
    (
        [
            (header::CONTENT_TYPE, "application/json"),
            (header::CACHE_CONTROL, "no-cache"),
            (header::VARY, "host"),
        ],
        told,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, json_of};
    use crate::identity::access::TABLE;
    use axum::http::Method;
    use serde_json::{Value, json};
    use std::collections::BTreeSet;
    use std::path::Path;

    fn parsed() -> Value {
        serde_json::from_str(&DOCUMENT).unwrap()
    }

    /// Each operation: method, path, and what is said of it.
    fn operations(document: &Value) -> Vec<(String, String, Value)> {
        let paths = document["paths"].as_object().unwrap();
        let of = |(path, item): (&String, &Value)| {
            let methods = item.as_object().unwrap().iter();
            methods.map(|(m, o)| (m.to_uppercase(), path.clone(), o.clone())).collect::<Vec<_>>()
        };
        paths.iter().flat_map(of).collect()
    }

    /// Catches: a route that is not described, one that is described and not served, and one that the table of roles does not
    /// know.
    #[test]
    fn every_route_is_described_and_every_description_is_a_route() {
        let described: BTreeSet<_> =
            operations(&parsed()).into_iter().map(|(method, path, _)| (method, route_of(&path))).collect();
        let in_table: BTreeSet<_> = TABLE
            .iter()
            .filter_map(|(call, _)| match call {
                Call::Http(method, route) => Some(((*method).to_owned(), (*route).to_owned())),
                Call::Rpc(_) => None,
            })
            .collect();
        assert_eq!(described, in_table);
        let routes: BTreeSet<_> = described.into_iter().map(|(_, route)| route).collect();
        let served: BTreeSet<_> = crate::http::paths().into_iter().map(str::to_owned).collect();
        assert_eq!(routes, served);
    }

    /// Catches: an operation that a generated client cannot name, group or call, or that does not say what goes wrong.
    #[test]
    fn every_operation_says_all_that_a_client_needs() {
        let document = parsed();
        let tags: BTreeSet<_> =
            document["tags"].as_array().unwrap().iter().map(|tag| tag["name"].to_string()).collect();
        let mut ids = BTreeSet::new();
        for (method, path, operation) in operations(&document) {
            let here = format!("{method} {path}");
            assert!(ids.insert(operation["operationId"].as_str().unwrap().to_owned()), "{here}");
            assert!(tags.contains(&operation["tags"][0].to_string()), "{here}");
            assert!(operation["summary"].as_str().unwrap().ends_with('.'), "{here}");
            assert!(operation["responses"]["default"]["content"]["application/json"].is_object(), "{here}");
            let described: BTreeSet<_> = operation["parameters"]
                .as_array()
                .into_iter()
                .flatten()
                .inspect(|p| assert!(p["description"].is_string(), "{here}: {p}"))
                .filter(|p| p["in"] == "path")
                .map(|p| p["name"].as_str().unwrap().to_owned())
                .collect();
            let named: BTreeSet<_> =
                path.split('{').skip(1).map(|p| p.split('}').next().unwrap().to_owned()).collect();
            assert_eq!(described, named, "{here}");
        }
    }

    /// Catches: an operation that says it takes no identity, or another role than the table does.
    #[test]
    fn every_operation_says_who_may_ask() {
        for (method, path, operation) in operations(&parsed()) {
            let access = access::of(Call::Http(&method, &route_of(&path))).unwrap();
            let schemes: Vec<_> = operation["security"]
                .as_array()
                .unwrap()
                .iter()
                .map(|one| one.as_object().unwrap().keys().next().cloned().unwrap_or_default())
                .collect();
            let known = ["token", "session", "certificate"];
            let (expected, least) = match access {
                Access::Open => (vec![""], Value::Null),
                Access::Metrics => (vec!["token", "session", "certificate", ""], json!("viewer")),
                Access::AnyRole => (known.to_vec(), json!("any")),
                Access::Least(role) => (known.to_vec(), json!(role.name())),
            };
            assert_eq!(
                (schemes, &operation[LEAST_ROLE]),
                (expected.into_iter().map(str::to_owned).collect(), &least),
                "{path}"
            );
            let refused = ["401", "403"].map(|status| operation["responses"][status].is_object());
            assert!(access == Access::Open || refused == [true; 2], "{path}");
        }
    }

    /// Catches: a field without a word about it.
    #[test]
    fn every_field_is_described() {
        fn look(value: &Value, within: &str) {
            let properties = value["properties"].as_object().into_iter().flatten();
            for (name, property) in properties {
                // The tag of a union says which of them it is.
                let described =
                    property["description"].is_string() || property["oneOf"][0]["description"].is_string();
                assert!(described || name == "kind", "{within}.{name}: {property}");
                look(property, name);
            }
            for part in ["allOf", "oneOf"] {
                value[part].as_array().into_iter().flatten().for_each(|part| look(part, within));
            }
        }
        for (name, schema) in parsed()["components"]["schemas"].as_object().unwrap() {
            look(schema, name);
        }
    }

    /// Catches: a change of what is described that nobody looked at. What is meant is written down by
    /// `ECHOFIX_BLESS=1 cargo test -p echofix-server openapi`.
    #[test]
    fn the_document_in_the_repository_is_this_one() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/openapi.json");
        let made = format!("{}\n", *DOCUMENT);
        if std::env::var_os("ECHOFIX_BLESS").is_some() {
            std::fs::write(&path, &made).unwrap();
        }
        assert_eq!(made, std::fs::read_to_string(path).unwrap(), "is the change of the description meant?");
    }

    #[tokio::test]
    async fn it_is_served_with_the_address_of_the_port() {
        let site = TestSite::default();
        let forwarded = [("host", "maps.example"), ("x-forwarded-prefix", "/echofix")];
        let body = json_of(site.send(Method::GET, "/openapi.json", &forwarded).await).await;
        assert_eq!(body["openapi"], json!("3.1.0"));
        assert_eq!(body["info"]["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(body["servers"][0]["url"], "http://maps.example/echofix");
        assert_eq!(json_of(site.get("/openapi.json").await).await["servers"][0]["url"], "/");
    }
}

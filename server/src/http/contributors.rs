//! Who contributed, by keyed hashes: for operators, who may have to revoke one.

use std::cmp::Reverse;
use std::sync::Arc;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;
use uuid::Uuid;

use super::App;
use super::answers::{
    BUSY, ContributedUploadAnswer, ContributorAnswer, ContributorUploadsAnswer, ContributorsAnswer,
    ErrorAnswer, KnownUploadAnswer, RevocationAnswer,
};
use super::contributor::{hash_word, parse_hash};
use super::day::iso_date;
use super::error::Error;
use super::operations::fresh;
use crate::shares::Peer;
use crate::store::{ContributedUpload, ContributorFigures, UploadFate};

/// Contributors, or uploads of one, that are listed at once, at most, and without a limit.
const MAX_LISTED: usize = 1000;
const USUALLY_LISTED: usize = 100;

/// What comes first.
#[derive(Debug, Clone, Copy, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Who uploaded last.
    #[default]
    Last,
    /// Who uploaded most.
    Uploads,
    /// Of whom most is in quarantine.
    Quarantined,
    /// Of whom most was taken back.
    TakenBack,
}

impl Order {
    fn key(self, of: &ContributorFigures) -> u64 {
        match self {
            Self::Last => of.last,
            Self::Uploads => of.uploads,
            Self::Quarantined => of.quarantined,
            Self::TakenBack => of.taken_back,
        }
    }
}

/// Which contributors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Only {
    /// All.
    #[default]
    All,
    /// Those of whom anything is in quarantine.
    Quarantined,
    /// Those that are revoked.
    Revoked,
}

impl Only {
    fn holds(self, of: &ContributorFigures) -> bool {
        match self {
            Self::All => true,
            Self::Quarantined => of.quarantined > 0,
            Self::Revoked => of.revoked.is_some(),
        }
    }
}

/// `?sort=&only=&hash=&offset=&limit=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ContributorsQuery {
    /// What comes first: who uploaded `last` or most (`uploads`), or of whom most is `quarantined` or `taken_back`.
    #[param(inline, required = false)]
    #[serde(default)]
    sort: Order,
    /// Which contributors: `all`, those of whom anything is `quarantined`, or those that are `revoked`.
    #[param(inline, required = false)]
    #[serde(default)]
    only: Only,
    /// With what the hashes begin.
    #[param(default = "", required = false, max_length = 16)]
    #[serde(default)]
    hash: String,
    /// How many of them are passed over.
    #[param(minimum = 0, default = 0, required = false)]
    #[serde(default)]
    offset: usize,
    /// How many are listed.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<usize>,
}

/// `GET /api/v1/contributors?sort=&only=&hash=&offset=&limit=`
#[utoipa::path(
    get,
    path = "/api/v1/contributors",
    operation_id = "getContributors",
    tag = "history",
    summary = "Who contributed what is not compacted, by keyed hashes.",
    description = "",
    params(ContributorsQuery),
    responses(
        (status = 200, description = "A part of them.", body = ContributorsAnswer),
        (status = 400, description = "A bad parameter.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn contributors(
    State(app): State<Arc<App>>,
    peer: Peer,
    query: Result<Query<ContributorsQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(ContributorsQuery { sort, only, hash, offset, limit }) = query?;
    let limit = listed(limit)?;
    let begins = hash.to_ascii_lowercase();
    if begins.len() > 16 || !begins.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(Error::BadRequest("hash must be hexadecimal digits, 16 at most".to_owned()));
    }
    let operations = Arc::clone(&app.state.operations);
    let read = app.limiter.work(peer, move || {
        let mut found = operations.contributors()?;
        found.retain(|of| only.holds(of) && hash_word(of.hash).starts_with(&begins));
        found.sort_unstable_by_key(|of| (Reverse(sort.key(of)), of.hash));
        let contributors = found.iter().skip(offset).take(limit).map(contributor).collect();
        Ok(ContributorsAnswer { contributors, found: found.len() })
    });
    Ok(fresh(read.await?))
}

fn listed(limit: Option<usize>) -> Result<usize, Error> {
    let limit = limit.unwrap_or(USUALLY_LISTED);
    let refusal = || Error::BadRequest(format!("limit must lie within 1 and {MAX_LISTED}"));
    (1..=MAX_LISTED).contains(&limit).then_some(limit).ok_or_else(refusal)
}

fn contributor(of: &ContributorFigures) -> ContributorAnswer {
    let revoked = of.revoked.as_ref().map(|revocation| RevocationAnswer {
        epoch: revocation.number,
        at_us: revocation.at_us,
        by: revocation.remark.by.clone(),
        reason: revocation.remark.reason.clone(),
    });
    ContributorAnswer {
        contributor: hash_word(of.hash),
        uploads: of.uploads,
        taken_back: of.taken_back,
        quarantined: of.quarantined,
        first_date: iso_date(of.first_day),
        last_date: iso_date(of.last_day),
        last_epoch: of.last,
        revoked,
    }
}

/// `?before=&limit=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ContributorUploadsQuery {
    /// Only uploads of earlier epochs.
    before: Option<u64>,
    /// How many uploads.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<usize>,
}

/// `GET /api/v1/contributors/{hash}/uploads?before=&limit=`
#[utoipa::path(
    get,
    path = "/api/v1/contributors/{hash}/uploads",
    operation_id = "getContributorUploads",
    tag = "history",
    summary = "What a contributor uploaded, of what is not compacted.",
    description = "",
    params(
        ("hash" = String, Path, description = "The contributor's keyed hash, 16 hexadecimal digits."),
        ContributorUploadsQuery,
    ),
    responses(
        (status = 200, description = "Newest first.", body = ContributorUploadsAnswer),
        (status = 400, description = "Not a keyed hash, or a bad parameter.", body = ErrorAnswer),
        (status = 404, description = "There is nothing of it that is not compacted.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn uploads(
    State(app): State<Arc<App>>,
    peer: Peer,
    Path(hash): Path<String>,
    query: Result<Query<ContributorUploadsQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(ContributorUploadsQuery { before, limit }) = query?;
    let limit = listed(limit)?;
    let malformed = || Error::BadRequest(format!("`{hash}` is no contributor hash: 16 hexadecimal digits"));
    let contributor = parse_hash(&hash).ok_or_else(malformed)?;
    let operations = Arc::clone(&app.state.operations);
    let read = app.limiter.work(peer, move || {
        let before = before.unwrap_or(u64::MAX);
        // One more says whether there are more.
        let mut uploads = operations.uploads_of(contributor, before, limit + 1)?;
        if uploads.is_empty() && before == u64::MAX {
            let word = hash_word(contributor);
            return Err(Error::NotFound(format!(
                "contributor {word} has uploaded nothing that is not compacted"
            )));
        }
        let more = uploads.len() > limit;
        uploads.truncate(limit);
        let next_before = uploads.last().filter(|_| more).map(|upload| upload.number);
        let uploads = uploads.iter().map(upload_answer).collect();
        Ok(ContributorUploadsAnswer { contributor: hash_word(contributor), uploads, next_before })
    });
    Ok(fresh(read.await?))
}

/// `GET /api/v1/uploads/{id}`
#[utoipa::path(
    get,
    path = "/api/v1/uploads/{id}",
    operation_id = "getUpload",
    tag = "history",
    summary = "An upload by its id, what became of it, and who contributed it.",
    description = "",
    params(("id" = String, Path, description = "The id that its contributor chose: a UUID.")),
    responses(
        (status = 200, description = "The upload.", body = KnownUploadAnswer),
        (status = 400, description = "Not a UUID.", body = ErrorAnswer),
        (status = 404, description = "No such upload is in the journal, or it is compacted.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn upload(
    State(app): State<Arc<App>>,
    peer: Peer,
    Path(id): Path<String>,
) -> Result<Response, Error> {
    let malformed = |error| Error::BadRequest(format!("`{id}` is not a UUID: {error}"));
    let id = Uuid::try_parse(&id).map_err(malformed)?;
    let operations = Arc::clone(&app.state.operations);
    let found = app.limiter.work(peer, move || Ok(operations.upload(id)?)).await?;
    let missing =
        || Error::NotFound(format!("no upload {id} is in the journal; what is compacted is forgotten"));
    let (contributor, upload) = found.ok_or_else(missing)?;
    Ok(fresh(KnownUploadAnswer { contributor: hash_word(contributor), upload: upload_answer(&upload) }))
}

fn upload_answer(upload: &ContributedUpload) -> ContributedUploadAnswer {
    let outcome = match upload.fate {
        UploadFate::Counted => "COUNTED",
        UploadFate::Quarantined => "QUARANTINED",
        UploadFate::TakenBack => "TAKEN_BACK",
    };
    ContributedUploadAnswer {
        epoch: upload.number,
        upload_id: upload.id.map(|id| id.to_string()),
        date: iso_date(upload.day),
        outcome,
    }
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{StoredSite, gate_of, json_of, uploads_of};
    use crate::identity::Gate;
    use crate::store::Policy;
    use serde_json::{Value, json};

    /// Contributor 7 with three uploads, 8 with one, 9 with two, the last one of which is the newest of all.
    async fn site(gate: Gate) -> StoredSite {
        let uploads = uploads_of(&[(7, &[1]), (7, &[2]), (8, &[3]), (9, &[4]), (7, &[5]), (9, &[6])]);
        StoredSite::of(uploads, Policy::trusting(), gate).await
    }

    async fn hashes(site: &StoredSite, query: &str) -> (Vec<u64>, u64) {
        let told = json_of(site.get(&format!("/api/v1/contributors{query}")).await).await;
        let hash = |of: &Value| u64::from_str_radix(of["contributor"].as_str().unwrap(), 16).unwrap();
        let all = told["contributors"].as_array().unwrap_or_else(|| panic!("{query}: {told}"));
        (all.iter().map(hash).collect(), told["found"].as_u64().unwrap())
    }

    /// Catches: an order, a filter or a part of the list that is not what was asked for, and bad input that is taken.
    #[tokio::test]
    async fn contributors_are_sorted_filtered_and_listed_in_parts() {
        let site = site(Gate::open()).await;
        assert_eq!(hashes(&site, "").await, (vec![9, 7, 8], 3));
        assert_eq!(hashes(&site, "?sort=uploads").await, (vec![7, 9, 8], 3));
        assert_eq!(
            hashes(&site, "?sort=quarantined").await,
            (vec![7, 8, 9], 3),
            "equal ones by their hashes"
        );
        assert_eq!(hashes(&site, "?sort=uploads&offset=1&limit=1").await, (vec![9], 3));
        assert_eq!(hashes(&site, "?offset=3").await, (vec![], 3));
        assert_eq!(hashes(&site, "?only=revoked").await, (vec![], 0));
        assert_eq!(hashes(&site, "?hash=0000000000000008").await, (vec![8], 1));
        assert_eq!(hashes(&site, "?hash=00000000").await.1, 3);
        for bad in [
            "?limit=0",
            "?limit=1001",
            "?sort=name",
            "?only=some",
            "?hash=xyz",
            "?offset=-1",
            "?hash=00000000000000000",
        ] {
            assert_eq!(site.get(&format!("/api/v1/contributors{bad}")).await.status(), 400, "{bad}");
        }
    }

    /// Catches: uploads that are told as somebody else's, twice or not at all, and what a decision changes that is not told.
    #[tokio::test]
    async fn a_revocation_shows_until_it_is_undone() {
        let site = site(Gate::open()).await;
        let path = "/api/v1/contributors/0000000000000007/uploads";
        let first = json_of(site.get(&format!("{path}?limit=2")).await).await;
        let epochs = |told: &Value| -> Vec<u64> {
            told["uploads"].as_array().unwrap().iter().map(|of| of["epoch"].as_u64().unwrap()).collect()
        };
        assert_eq!((epochs(&first), &first["next_before"]), (vec![5, 2], &json!(2)));
        assert_eq!(first["uploads"][0]["upload_id"], json!(site.uploads[4].id));
        assert_eq!(first["uploads"][0]["outcome"], "COUNTED");
        let alone = json_of(site.get(&format!("/api/v1/uploads/{}", site.uploads[4].id)).await).await;
        assert_eq!((&alone["contributor"], &alone["epoch"]), (&json!("0000000000000007"), &json!(5)));
        let rest = json_of(site.get(&format!("{path}?limit=2&before=2")).await).await;
        assert_eq!((epochs(&rest), rest.get("next_before")), (vec![1], None));

        let body = json!({ "contributor_hash": "0000000000000007", "reason": "bent antenna" });
        let decided = json_of(site.post("/api/v1/map/revoke", &body).await).await;
        site.caught_up().await;
        let told = json_of(site.get("/api/v1/contributors?only=revoked").await).await;
        let revoked = &told["contributors"][0];
        assert_eq!(
            (&told["found"], &revoked["taken_back"], &revoked["uploads"]),
            (&json!(1), &json!(3), &json!(3))
        );
        assert_eq!(
            (&revoked["revoked"]["epoch"], &revoked["revoked"]["reason"]),
            (&decided["epoch"], &json!("bent antenna"))
        );
        let all = json_of(site.get(path).await).await;
        assert!(all["uploads"].as_array().unwrap().iter().all(|of| of["outcome"] == "TAKEN_BACK"), "{all}");

        site.post("/api/v1/map/undo", &json!({ "decision": decided["epoch"] })).await;
        site.caught_up().await;
        assert_eq!(hashes(&site, "?only=revoked").await.1, 0);
        let all = json_of(site.get(path).await).await;
        assert!(all["uploads"].as_array().unwrap().iter().all(|of| of["outcome"] == "COUNTED"), "{all}");
        for (path, status) in [
            ("/api/v1/contributors/7/uploads", 400),
            ("/api/v1/contributors/0000000000000001/uploads", 404),
            ("/api/v1/contributors/0000000000000007/uploads?limit=0", 400),
            ("/api/v1/uploads/7", 400),
            ("/api/v1/uploads/00000000-0000-0000-0000-000000000000", 404),
        ] {
            assert_eq!(site.get(path).await.status(), status, "{path}");
        }
    }

    /// Catches: viewers who learn who contributes.
    #[tokio::test]
    async fn only_operators_are_told_of_contributors() {
        let site = site(gate_of("viewer")).await;
        let upload = format!("/api/v1/uploads/{}", site.uploads[0].id);
        for path in ["/api/v1/contributors", "/api/v1/contributors/0000000000000007/uploads", &upload] {
            // Who is nobody in particular may have a token.
            assert_eq!(site.get(path).await.status(), 401, "{path}");
        }
    }
}

//! Tokens that were signed by another program (`openssl dgst -sha256 -sign`), and key sets of all kinds.

use super::*;
use crate::identity::config::IdentityConfig;
use crate::identity::tls::now_s;

const MODULUS: &str = "l7gtKK2hOWs_ASh7l263ZqXaSFxp_Fzt8ebSnS4ngwW__dywkdq7McaYDu7PRth0blOfgB08z1jZac41kW8O0_LMyd6u5hPDyB0P\
     5aQk77oZqtYaR7nMCJeiNX9gcKiyvFjIATHNzeFfDf6QJ8Gml1NVsO2UyUNCEalxUev_J2aL1lOPibT-hvnpspzieRdgdkcHtTMA\
     UMvDpoCtUfoPxtYZ8oyxVNa8DasZfjb0Panve0V83H3-tqLegUmyn59SmpsR2sWsBNU-2uAa0u7iUKTyAGZNGl_iyvj2mVwb8bUu\
     fMG0QBw8PNKdju7PyMLXaSmN3hdNRpOb9NKi9E9YKQ";
const RS256: &str = "eyJhbGciOiAiUlMyNTYiLCAia2lkIjogInIxIn0.eyJpc3MiOiAiaHR0cHM6Ly9pc3N1ZXIuZXhhbXBsZSIsICJhdWQiOiBbImVj\
     aG9maXgiLCAib3RoZXIiXSwgInN1YiI6ICJjYXItNyIsICJyb2xlcyI6IFsiY2FycyIsICJub3RoaW5nIl0sICJuYmYiOiAxNzAw\
     MDAwMDAwLCAiZXhwIjogNDEwMjQ0NDgwMH0.HUN2ijwf4yqiONxI9-8UosD4-MBbnNAT5q-mcfq2HBu7eE_LtzufeJbT6Y12MKR6\
     lXTBZhFIZaZdR94wi-hT8XHBNW5Q0sDxYL823iR1v7jkljctfBPiWJx9UN5-fLPWu7_8G7kzMA8YtVfi2SnRN3swMD2vnBQMB73H\
     8x6-7797YLS-ipAfy0xcnppen5fhxiK7Sf5a10voq3VuGkQ9zEjjbMPkZbxKKI-ZMN7a4s07pH5GGShLN9R0ErPwg2oRUgwifbZZ\
     8NlF5Wa3HxZ3DaQkD2x_A4PfAIR7RPXBMujiOZwi4FTeqbkjGp--ad5__de_jW-OoXOhOY9AWqpycA";
const PS256: &str = "eyJhbGciOiAiUFMyNTYiLCAia2lkIjogInIxIn0.eyJpc3MiOiAiaHR0cHM6Ly9pc3N1ZXIuZXhhbXBsZSIsICJhdWQiOiBbImVj\
     aG9maXgiLCAib3RoZXIiXSwgInN1YiI6ICJjYXItNyIsICJyb2xlcyI6IFsiY2FycyIsICJub3RoaW5nIl0sICJuYmYiOiAxNzAw\
     MDAwMDAwLCAiZXhwIjogNDEwMjQ0NDgwMH0.Kmpe5Xgwl_1bA0eFIUSdd-ic2VuGWnaGENO39rr2Jw4JWv2Za1Q0LHZaz29QLDFz\
     CDcUAaZF-OL9on0TjOSYFDP8R6DPoN4OvRMa4YdJyClmmGri8nypJTlKTwKA6m_Uoni3vWjQZ-O9ThPnEtBaDEFZbTE811JQwIda\
     gcsEcvNflPseDD5xPJXPEJvMmWDoHxqbJbDKhgah9qfSTwHr1P1aTQIaaicJiQFslAWju289Zr5tAreHBiyY-3qOaFZtibtrH9Lx\
     v7zrvAsnNmV8aMwWv3Kvx53ebQfIy6brBXveAdKa2am-ibq3nGZ0fqo_mTeh2rmZMn1zPldMKWOQGQ";

fn config() -> IdentityConfig {
    IdentityConfig {
        jwt_jwks: "keys.json".to_owned(),
        jwt_issuer: "https://issuer.example".to_owned(),
        jwt_audience: "echofix".to_owned(),
        jwt_name_claim: "sub".to_owned(),
        jwt_role_claim: "roles".to_owned(),
        jwt_roles: vec!["cars=mapper".to_owned()],
        jwt_refresh_s: 300,
        ..IdentityConfig::default()
    }
}

fn rsa(more: &str) -> String {
    format!(r#"{{"kty":"RSA","n":"{MODULUS}","e":"AQAB"{more}}}"#)
}

fn set(keys: &[String]) -> Result<Keys, String> {
    check(format!(r#"{{"keys":[{}]}}"#, keys.join(",")).as_bytes())
}

/// Catches: signatures of other programs that are not understood, and an algorithm that the key is not for.
#[test]
fn both_rsa_signatures_are_taken_with_a_key_that_is_for_them() {
    let taken = |token: &str, keys: &Keys| told_by(token, keys, &config());
    let both = set(&[rsa(r#","kid":"r1","use":"sig""#)]).unwrap();
    for token in [RS256, PS256] {
        let told = taken(token, &both).unwrap();
        assert_eq!((told.name.as_str(), told.roles.to_string().as_str()), ("car-7", "mapper"));
        assert!(told.lease.holds(&both, now_s()) && !told.lease.holds(&both, 4_102_444_800));
        assert!(!told.lease.holds(&Keys::default(), now_s()), "its key is gone");
    }
    let one = set(&[rsa(r#","kid":"r1","alg":"RS256""#)]).unwrap();
    assert!(taken(RS256, &one).is_ok() && taken(PS256, &one).is_err());
    let other = set(&[rsa(r#","kid":"r2""#)]).unwrap();
    assert_eq!(taken(RS256, &other), Err(NotTaken::UnknownKey));
    let (message, _) = RS256.rsplit_once('.').unwrap();
    let (_, signature) = PS256.rsplit_once('.').unwrap();
    for bad in [format!("{message}."), format!("{message}.{signature}"), "..".to_owned(), "a.b.c".to_owned()]
    {
        assert!(taken(&bad, &both).is_err(), "{bad}");
    }
    let long = format!("{}.{message}", "a".repeat(MAX_TOKEN_BYTES));
    assert!(taken(&long, &both).unwrap_err().to_string().contains("longer"));
}

/// Catches: claims that stand for nothing and give a role, and claims that are looked for in the wrong place.
#[test]
fn only_what_is_mapped_gives_a_role() {
    let keys = set(&[rsa(r#","kid":"r1""#)]).unwrap();
    let with = |change: &dyn Fn(&mut IdentityConfig)| {
        let mut config = config();
        change(&mut config);
        told_by(RS256, &keys, &config)
    };
    assert!(with(&|c| c.jwt_roles = vec!["fleet=mapper".to_owned()]).is_err());
    assert!(with(&|c| c.jwt_role_claim = "groups".to_owned()).is_err());
    assert!(with(&|c| c.jwt_role_claim = "/roles".to_owned()).is_ok());
    assert!(with(&|c| c.jwt_name_claim = "/sub".to_owned()).is_ok());
    assert!(with(&|c| c.jwt_name_claim = "iss".to_owned()).is_err(), "its slashes mean something");
    assert!(with(&|c| c.jwt_name_claim = "roles".to_owned()).is_err());
    assert!(with(&|c| c.jwt_audience = "another".to_owned()).unwrap_err().to_string().contains("audience"));
    assert!(with(&|c| c.jwt_issuer = "https://other".to_owned()).unwrap_err().to_string().contains("issuer"));
}

/// Catches: a key set that replaces a good one and lets nobody in, or lets in who has a secret everybody knows.
#[test]
fn key_sets_are_checked_before_they_count() {
    let oct = r#"{"kty":"oct","kid":"s","k":"c2VjcmV0"}"#.to_owned();
    let curve = r#"{"kty":"EC","crv":"P-384","kid":"e","x":"AA","y":"AA"}"#.to_owned();
    let small = r#"{"kty":"RSA","kid":"s","n":"AQAB","e":"AQAB"}"#.to_owned();
    let useless = [oct, curve, unheard_key(), small, rsa(r#","use":"enc""#), rsa(r#","alg":"HS256""#)];
    for key in &useless {
        assert!(set(std::slice::from_ref(key)).err().unwrap().contains("no key"), "{key}");
    }
    assert!(set(&[&useless[..], &[rsa(r#","kid":"r1""#)]].concat()).is_ok(), "the others are passed over");
    assert!(set(&[rsa(r#","kid":"r1""#), rsa(r#","kid":"r1""#)]).err().unwrap().contains("same id"));
    assert!(set(&vec![unheard_key(); 65]).err().unwrap().contains("65 keys"));
    assert!(check(b"[]").is_err() && check(b"<html>").is_err());
}

fn unheard_key() -> String {
    r#"{"kty":"new"}"#.to_owned()
}

/// Catches: keys that anybody on the way could exchange, and settings that make no sense together.
#[test]
fn settings_that_make_no_sense_are_named() {
    for (text, fits) in [
        ("https://issuer.example/keys", true),
        ("http://127.0.0.1:9/keys", true),
        ("http://[::1]:9/keys", true),
        ("http://issuer.example/keys", false),
        ("ftp://localhost/keys", false),
        ("keys.json", false),
    ] {
        assert_eq!(is_address(text), fits, "{text}");
    }
    let broken = |change: &dyn Fn(&mut IdentityConfig)| {
        let mut config = config();
        change(&mut config);
        rules_of(&config).into_iter().find(|(_, holds, _)| !holds).map(|(key, ..)| key)
    };
    assert_eq!(broken(&|_| {}), None);
    assert_eq!(broken(&|c| *c = IdentityConfig::default()), None);
    assert_eq!(broken(&|c| c.jwt_jwks = "http://issuer.example/".to_owned()), Some("identity.jwt_jwks"));
    assert_eq!(broken(&|c| c.jwt_audience.clear()), Some("identity.jwt_audience"));
    assert_eq!(broken(&|c| c.jwt_jwks.clear()), Some("identity.jwt_issuer"));
    assert_eq!(broken(&|c| c.jwt_leeway_s = 301), Some("identity.jwt_leeway_s"));
    for roles in [vec![], vec!["cars=root".to_owned()], vec!["=mapper".to_owned()], vec!["mapper".to_owned()]]
    {
        assert_eq!(broken(&|c| c.jwt_roles.clone_from(&roles)), Some("identity.jwt_roles"), "{roles:?}");
    }
}

//! The name and the roles that a certificate's URIs tell. Its common name tells nothing: anybody may have written it for
//! people to read.

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::FromDer;

use super::caller::is_name;
use super::role::{Role, Roles};
use super::tokens::hex;

/// Who a certificate is for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Subject {
    pub(super) name: String,
    pub(super) roles: Roles,
}

/// The subject of a certificate whose chain was checked; an error in words for its holder.
pub(super) fn subject(der: &[u8], trust_domain: &str) -> Result<Subject, String> {
    let (_, certificate) = X509Certificate::from_der(der).map_err(|_| "the certificate cannot be read")?;
    let names = certificate.subject_alternative_name().map_err(|_| "its alternative names cannot be read")?;
    let uris = names.iter().flat_map(|names| &names.value.general_names).filter_map(|name| match name {
        GeneralName::URI(uri) => Some(*uri),
        _ => None,
    });
    let mut subject: Option<Subject> = None;
    for (role, name) in uris.filter_map(|uri| told_by(uri, trust_domain)) {
        let known = subject.get_or_insert_with(|| Subject { name: name.to_owned(), roles: Roles::default() });
        if known.name != name {
            return Err("the certificate's URIs name several callers; a certificate is for one".to_owned());
        }
        known.roles = known.roles.with(role);
    }
    subject.ok_or_else(|| {
        "the certificate names no caller; it needs a URI among its alternative names, echofix://ROLE/NAME or \
         spiffe://DOMAIN/echofix/ROLE/NAME"
            .to_owned()
    })
}

/// The end of a certificate's time, seconds since the Unix epoch; `None` when it cannot be read.
pub(super) fn not_after(der: &[u8]) -> Option<i64> {
    let (_, certificate) = X509Certificate::from_der(der).ok()?;
    Some(certificate.validity().not_after.timestamp())
}

/// Whether a URI names a caller as the service reads it.
#[must_use]
pub fn is_caller_uri(uri: &str) -> bool {
    told_by(uri, "").is_some()
}

/// The serial number of the first certificate in a PEM text, in hexadecimal digits.
#[must_use]
pub fn serial_of_pem(pem: &[u8]) -> Option<String> {
    let der = CertificateDer::from_pem_slice(pem).ok()?;
    let (_, certificate) = X509Certificate::from_der(&der).ok()?;
    Some(hex(certificate.raw_serial()))
}

/// Role and name of `echofix://ROLE/NAME` or `spiffe://DOMAIN/echofix/ROLE/NAME`.
fn told_by<'a>(uri: &'a str, trust_domain: &str) -> Option<(Role, &'a str)> {
    if let Some(path) = uri.strip_prefix("echofix://") {
        return role_and_name(path);
    }
    let (domain, path) = uri.strip_prefix("spiffe://")?.split_once('/')?;
    (trust_domain.is_empty() || trust_domain == domain).then_some(())?;
    role_and_name(path.strip_prefix("echofix/")?)
}

/// Role and name of `ROLE/NAME`.
pub(super) fn role_and_name(text: &str) -> Option<(Role, &str)> {
    let (role, name) = text.split_once('/')?;
    Some((role.parse().ok()?, name)).filter(|_| is_name(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_tell_role_and_name_and_anything_else_tells_nothing() {
        assert_eq!(told_by("echofix://mapper/car-7", ""), Some((Role::Mapper, "car-7")));
        let spiffe = "spiffe://fleet.example/echofix/operator/ops/alice";
        assert_eq!(told_by(spiffe, ""), Some((Role::Operator, "ops/alice")));
        assert_eq!(told_by(spiffe, "fleet.example"), Some((Role::Operator, "ops/alice")));
        assert_eq!(told_by(spiffe, "other.example"), None);
        for other in [
            "echofix://root/a",
            "echofix://mapper/",
            "echofix://mapper",
            "echofix://mapper/a b",
            "echofix://mapper/../a",
            "https://mapper/a",
            "spiffe://d/mapper/a",
            "ECHOFIX://mapper/a",
        ] {
            assert_eq!(told_by(other, ""), None, "{other}");
        }
    }
}

//! An authority in a folder: ca.pem and ca.key, crl.pem and the numbers it lists, and what it issued.

use std::fs::{self, DirBuilder, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, ensure};
use echofix_server::identity::{Role, serial_of_pem};
use rcgen::string::Ia5String;
use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, DistinguishedName, DnType,
    ExtendedKeyUsagePurpose, IsCa, Issuer, KeyIdMethod, KeyPair, KeyUsagePurpose, RevokedCertParams, SanType,
    SerialNumber,
};

/// How long certificates hold: what is issued about a year, the authority ten.
const YEAR: Duration = Duration::from_hours(24 * 365);
/// Clocks differ.
const EARLIER: Duration = Duration::from_hours(1);

/// What signs certificates.
pub struct Authority {
    dir: PathBuf,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// Makes one in a folder, with a list of revoked certificates that is empty.
    pub fn found(dir: &Path) -> anyhow::Result<Self> {
        let making = || format!("making {}", dir.display());
        DirBuilder::new().recursive(true).mode(0o700).create(dir).with_context(making)?;
        let mut params = params("Echofix authority", 10 * YEAR);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let key = KeyPair::generate()?;
        let certificate = params.self_signed(&key)?;
        write(&dir.join("ca.key"), key.serialize_pem().as_bytes(), 0o600)?;
        write(&dir.join("ca.pem"), certificate.pem().as_bytes(), 0o644)?;
        let authority = Self { dir: dir.to_owned(), issuer: Issuer::new(params, key) };
        authority.write_list(&[])?;
        Ok(authority)
    }

    /// The one in a folder.
    pub fn open(dir: &Path) -> anyhow::Result<Self> {
        let read = |name: &str| {
            let path = dir.join(name);
            fs::read_to_string(&path).with_context(|| {
                format!("reading {}; `echofix identity init` makes an authority", path.display())
            })
        };
        let key = KeyPair::from_pem(&read("ca.key")?).context("reading ca.key")?;
        let issuer = Issuer::from_ca_cert_pem(&read("ca.pem")?, key).context("reading ca.pem")?;
        Ok(Self { dir: dir.to_owned(), issuer })
    }

    /// The service's certificate, for names and addresses by which callers reach it.
    pub fn service(&self, names: &[String]) -> anyhow::Result<()> {
        let mut params = params("Echofix", YEAR);
        params.subject_alt_names = CertificateParams::new(names)
            .context("a name of the service cannot be used; give host names and addresses")?
            .subject_alt_names;
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        self.sign(params, "server").map(drop)
    }

    /// A caller's certificate; returns its file.
    pub fn issue(&self, role: Role, name: &str) -> anyhow::Result<PathBuf> {
        let mut params = params(name, YEAR);
        let uri = format!("echofix://{role}/{name}");
        ensure!(
            echofix_server::identity::is_caller_uri(&uri),
            "`{name}` is no name; use letters, digits and -._~@:+/, 64 at most"
        );
        params.subject_alt_names = vec![SanType::URI(Ia5String::try_from(uri)?)];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        self.sign(params, &name.replace('/', "_"))
    }

    fn sign(&self, mut params: CertificateParams, file: &str) -> anyhow::Result<PathBuf> {
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.use_authority_key_identifier_extension = true;
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &self.issuer)?;
        let path = self.dir.join(format!("{file}.pem"));
        write(&path.with_extension("key"), key.serialize_pem().as_bytes(), 0o600)?;
        write(&path, certificate.pem().as_bytes(), 0o644)?;
        Ok(path)
    }

    /// Adds a certificate to the list of revoked ones; returns how many are on it.
    pub fn revoke(&self, certificate: &Path) -> anyhow::Result<usize> {
        let reading = || format!("reading {}", certificate.display());
        let pem = fs::read(certificate).with_context(reading)?;
        let serial = serial_of_pem(&pem).context("the file holds no certificate in PEM")?;
        // The list is made with the authority: without it, a new one would let back in whoever was revoked before.
        let known = fs::read_to_string(self.revoked_file());
        let known = known.with_context(|| format!("reading {}", self.revoked_file().display()))?;
        let mut lines: Vec<String> = known.lines().map(str::to_owned).collect();
        if !lines.contains(&serial) {
            lines.push(serial);
        }
        self.write_list(&lines)?;
        Ok(lines.len())
    }

    /// The list as it is signed, and the numbers it is made of: replaced, so that nobody reads half of it.
    fn write_list(&self, serials: &[String]) -> anyhow::Result<()> {
        let now = SystemTime::now();
        let revoked = serials.iter().map(|serial| {
            Ok(RevokedCertParams {
                serial_number: SerialNumber::from(unhex(serial).context("revoked.txt holds something else")?),
                revocation_time: (now - EARLIER).into(),
                reason_code: None,
                invalidity_date: None,
            })
        });
        let since = now.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let list = CertificateRevocationListParams {
            this_update: (now - EARLIER).into(),
            next_update: (now + 10 * YEAR).into(),
            crl_number: SerialNumber::from(since.as_secs()),
            issuing_distribution_point: None,
            revoked_certs: revoked.collect::<anyhow::Result<_>>()?,
            key_identifier_method: KeyIdMethod::Sha256,
        };
        let list = list.signed_by(&self.issuer)?.pem()?;
        let numbers: String = serials.iter().flat_map(|serial| [serial.as_str(), "\n"]).collect();
        for (path, text) in [(self.revoked_file(), numbers), (self.dir.join("crl.pem"), list)] {
            let fresh = path.with_extension("new");
            let _ = fs::remove_file(&fresh);
            write(&fresh, text.as_bytes(), 0o644)?;
            fs::rename(&fresh, &path).with_context(|| format!("writing {}", path.display()))?;
        }
        Ok(())
    }

    fn revoked_file(&self) -> PathBuf {
        self.dir.join("revoked.txt")
    }
}

fn params(common_name: &str, holds: Duration) -> CertificateParams {
    let now = SystemTime::now();
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, common_name);
    params.not_before = (now - EARLIER).into();
    params.not_after = (now + holds).into();
    params
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let byte = |at: usize| u8::from_str_radix(text.get(at..at + 2)?, 16).ok();
    (0..text.len()).step_by(2).map(byte).collect()
}

/// Writes a new file; one that is there stays as it is.
fn write(path: &Path, bytes: &[u8], mode: u32) -> anyhow::Result<()> {
    let writing = || format!("writing {}", path.display());
    let mut out =
        OpenOptions::new().create_new(true).write(true).mode(mode).open(path).with_context(writing)?;
    out.write_all(bytes).and_then(|()| out.sync_all()).with_context(writing)
}

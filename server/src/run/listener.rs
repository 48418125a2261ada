//! A port that listens: an address of the network, or a unix socket.

use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::UnixStream as Probe;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, fchmod};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixSocket, UnixStream};

use crate::listen::{ListenAddress, RemoteAddress};

/// Connections that may wait to be accepted on a unix socket.
const WAITING: u32 = 1024;
/// Only the service itself.
const OWN: u32 = 0o600;

/// A port that listens.
pub(super) enum Listener {
    Tcp(TcpListener),
    Unix {
        socket: UnixListener,
        /// Removed with it.
        _file: SocketFile,
    },
}

/// A connection as it was accepted.
pub(super) enum Accepted {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Listener {
    /// Takes an address, with the rights on the file of a unix socket; returns the address that it is.
    pub(super) async fn bind(address: &ListenAddress, mode: u32) -> io::Result<(Self, ListenAddress)> {
        match address {
            ListenAddress::Tcp(address) => {
                let listener = TcpListener::bind(address).await?;
                let bound = ListenAddress::Tcp(listener.local_addr()?);
                Ok((Self::Tcp(listener), bound))
            }
            ListenAddress::Unix(path) => {
                let (socket, file) = unix(path, mode)?;
                Ok((Self::Unix { socket, _file: file }, address.clone()))
            }
        }
    }

    pub(super) async fn accept(&self) -> io::Result<(Accepted, RemoteAddress)> {
        match self {
            Self::Tcp(listener) => {
                let (stream, address) = listener.accept().await?;
                Ok((Accepted::Tcp(stream), RemoteAddress::Ip(address.ip())))
            }
            Self::Unix { socket, .. } => {
                let (stream, _) = socket.accept().await?;
                Ok((Accepted::Unix(stream), RemoteAddress::Unix))
            }
        }
    }
}

fn unix(path: &Path, mode: u32) -> io::Result<(UnixListener, SocketFile)> {
    clear(path)?;
    let socket = UnixSocket::new_stream()?;
    // Linux gives these rights to the file; elsewhere the file has them a moment later.
    let _ = fchmod(&socket, Mode::from_raw_mode(OWN));
    socket.bind(path)?;
    let file = SocketFile::of(path)?;
    fs::set_permissions(path, Permissions::from_mode(mode))?;
    Ok((socket.listen(WAITING)?, file))
}

/// Removes what a service left that was killed: a socket on which nobody listens. Nothing else is ever removed.
fn clear(path: &Path) -> io::Result<()> {
    let there = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        there => there?,
    };
    if !there.file_type().is_socket() {
        let why = "there is something that is no socket; remove it, or name another path";
        return Err(io::Error::new(ErrorKind::AlreadyExists, why));
    }
    match Probe::connect(path) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path),
        Ok(_) => Err(io::Error::new(ErrorKind::AddrInUse, "another program listens there")),
        Err(error) => Err(error),
    }
}

/// A socket's file, removed with it unless another has taken its place.
pub(super) struct SocketFile {
    path: PathBuf,
    made: (u64, u64),
}

impl SocketFile {
    fn of(path: &Path) -> io::Result<Self> {
        Ok(Self { path: path.to_owned(), made: which(path)? })
    }
}

fn which(path: &Path) -> io::Result<(u64, u64)> {
    let there = fs::symlink_metadata(path)?;
    Ok((there.dev(), there.ino()))
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if which(&self.path).is_ok_and(|there| there == self.made) {
            // A file that stays is removed by the next service.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(path: &Path) -> ListenAddress {
        ListenAddress::Unix(path.to_owned())
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    /// Catches: a socket that everybody may connect to, a service that cannot start again after it was killed, and one that
    /// takes another's place.
    #[tokio::test]
    async fn only_what_nobody_listens_on_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grpc");
        let (first, _) = Listener::bind(&at(&path), 0o600).await.unwrap();
        assert_eq!(mode(&path), 0o600);
        let second = Listener::bind(&at(&path), 0o600).await.err().unwrap();
        assert_eq!(second.kind(), ErrorKind::AddrInUse);
        // As a kill leaves it: nobody listens, and the file stays.
        let Listener::Unix { socket, _file: file } = first else { panic!() };
        drop(socket);
        std::mem::forget(file);
        assert!(path.exists());
        let (third, bound) = Listener::bind(&at(&path), 0o660).await.unwrap();
        assert_eq!((mode(&path), bound), (0o660, at(&path)));
        drop(third);
        assert!(!path.exists(), "the end removes its own");
    }

    /// Catches: a file or a link of somebody's that a wrong setting removes.
    #[tokio::test]
    async fn what_is_no_socket_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "kept").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        for path in [&file, &link, &folder.path().to_owned()] {
            let refused = Listener::bind(&at(path), 0o600).await.err().unwrap();
            assert!(refused.to_string().contains("no socket"), "{refused}");
        }
        assert_eq!(fs::read_to_string(&link).unwrap(), "kept");
        let (own, _) = Listener::bind(&at(&folder.path().join("own")), 0o600).await.unwrap();
        // Another has taken its place: that is not removed.
        fs::remove_file(folder.path().join("own")).unwrap();
        fs::write(folder.path().join("own"), "another").unwrap();
        drop(own);
        assert!(folder.path().join("own").exists());
        let missing = Listener::bind(&at(&folder.path().join("none/own")), 0o600).await.err().unwrap();
        assert_eq!(missing.kind(), ErrorKind::NotFound);
    }
}

//! Files that are either whole or absent.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::Error;

/// Ends the name of a file that is being written.
const PARTIAL: &str = ".partial";

/// Writes `bytes` to a temporary name in the same folder, waits until the disk has them, and renames: a reader sees the old
/// file or the new one, never a part.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_atomically_with(path, |file| file.write_all(bytes))
}

/// The same of what `write` writes.
pub(super) fn write_atomically_with(
    path: &Path,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> Result<(), Error> {
    let name = path
        .file_name()
        .ok_or_else(|| Error::output(path, "not a file name"))?
        .to_string_lossy();
    let partial = path.with_file_name(format!(".{name}{PARTIAL}"));
    let write = || -> io::Result<()> {
        let mut file = File::create(&partial)?;
        write(&mut file)?;
        file.sync_all()?;
        fs::rename(&partial, path)
    };
    write().map_err(|problem| {
        // The first error is the one to report; a leftover that cannot be removed either is harmless.
        let _ = fs::remove_file(&partial);
        Error::unwritten(path, &problem)
    })
}

/// Whether a file name is that of a file whose writing did not end.
pub fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(PARTIAL)
}

/// Waits until the disk has the names of a folder's files, as far as the system can tell.
pub(super) fn sync_folder(path: &Path) {
    // Some file systems know no such thing, and then nothing is lost but certainty in a power failure.
    if cfg!(unix) {
        let _ = File::open(path).and_then(|folder| folder.sync_all());
    }
}

/// Creates a folder and those above it.
pub(super) fn create_folder(path: &Path) -> Result<(), Error> {
    fs::create_dir_all(path).map_err(|problem| Error::unwritten(path, &problem))
}

/// Holds a folder against other processes that would write into it, until it is dropped or the process ends, however it ends.
#[derive(Debug)]
pub struct FolderLock {
    path: PathBuf,
    /// The system lets go when this is closed.
    _file: File,
}

impl FolderLock {
    /// Takes the folder, which is made if absent.
    ///
    /// # Errors
    /// [`Error::Input`] where another process holds it, [`Error::Output`] where it cannot be written.
    pub fn take(folder: &Path) -> Result<FolderLock, Error> {
        create_folder(folder)?;
        let path = folder.join(".lock");
        loop {
            let file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(|problem| Error::unwritten(&path, &problem))?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::input(
                        folder.display().to_string(),
                        "another process writes into the folder",
                        "wait for its end, or choose another folder with --out",
                    ));
                }
                // A file system without locks: the folder is not guarded there.
                Err(TryLockError::Error(_)) | Ok(()) => {}
            }
            // Another process may have ended, and removed its file, since this one was opened.
            if is_at(&file, &path) {
                return Ok(FolderLock { path, _file: file });
            }
        }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // While it is still held: whoever has opened it finds out in `take`.
        let _ = fs::remove_file(&self.path);
    }
}

/// Whether an open file is the one that has the name now.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let number = |of: io::Result<fs::Metadata>| of.map(|of| (of.dev(), of.ino())).ok();
    number(file.metadata()) == number(fs::metadata(path))
}

/// Elsewhere a file that is open keeps its name.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

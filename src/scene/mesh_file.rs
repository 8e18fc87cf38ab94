//! Mesh files that a scene names.

use std::any::Any;
use std::fmt;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::error::Error;

/// A mesh file. Clones share its parsed contents, so a file is parsed once per scene.
#[derive(Clone)]
pub struct MeshFile {
    path: PathBuf,
    /// A type of `geometry`, which this room cannot name.
    contents: Arc<OnceLock<Arc<dyn Any + Send + Sync>>>,
}

impl MeshFile {
    /// The parsed contents; only the first call parses. Errors are not cached.
    pub(crate) fn contents<T: Any + Send + Sync>(
        &self,
        parse: impl FnOnce(&Path) -> Result<T, Error>,
    ) -> Result<Arc<T>, Error> {
        let contents = match self.contents.get() {
            Some(contents) => Arc::clone(contents),
            None => {
                let parsed = Arc::new(parse(&self.path)?);
                Arc::clone(self.contents.get_or_init(|| parsed))
            }
        };
        Ok(contents.downcast().expect("a mesh file has one kind of contents"))
    }
}

impl From<PathBuf> for MeshFile {
    fn from(path: PathBuf) -> MeshFile {
        let contents = Arc::default();
        MeshFile { path, contents }
    }
}

impl Deref for MeshFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

impl fmt::Debug for MeshFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.fmt(f)
    }
}

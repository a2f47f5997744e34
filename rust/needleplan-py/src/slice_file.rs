//! A file that takes the slices of a pass while they are finished, each at its place in three datasets.

use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use ppvi::Error;
use ppvi::space::SolvedSlice;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

/// A file with room for values, policy and success.
pub(crate) struct SliceFile {
    path: PathBuf,
    file: File,
    /// Place of the first byte of values, policy and success.
    offsets: [u64; 3],
    failure: Option<io::Error>,
}

impl SliceFile {
    /// Opens an existing file.
    ///
    /// # Errors
    /// OSError if it cannot be opened.
    pub(crate) fn open(path: &Path, offsets: [u64; 3]) -> PyResult<Self> {
        match OpenOptions::new().write(true).open(path) {
            Ok(file) => Ok(SliceFile { path: path.to_path_buf(), file, offsets, failure: None }),
            Err(error) => Err(os_error(path, &error)),
        }
    }

    /// Writes a slice.
    ///
    /// # Errors
    /// [`Error::Stopped`] if it cannot be written; [`SliceFile::require_written`] has the reason.
    pub(crate) fn take(&mut self, solved: SolvedSlice<'_>) -> ppvi::Result<()> {
        let [values, policy, success] = self.offsets;
        let mut put = |offset: u64, bytes: &[u8]| {
            self.file.seek(SeekFrom::Start(offset + (solved.slice * bytes.len()) as u64))?;
            self.file.write_all(bytes)
        };
        put(values, bytemuck::cast_slice(solved.values))
            .and_then(|()| put(policy, solved.policy))
            .and_then(|()| put(success, bytemuck::cast_slice(solved.success)))
            .map_err(|error| {
                self.failure = Some(error);
                Error::Stopped
            })
    }

    /// Raises the exception of the slice that could not be written.
    ///
    /// # Errors
    /// OSError with its number and the path.
    pub(crate) fn require_written(self) -> PyResult<()> {
        self.failure.map_or(Ok(()), |error| Err(os_error(&self.path, &error)))
    }
}

/// The OSError of Python for an error of the system.
fn os_error(path: &Path, error: &io::Error) -> PyErr {
    let text = error.to_string();
    let reason = text.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((error.raw_os_error(), reason, path.to_string_lossy().into_owned()))
}

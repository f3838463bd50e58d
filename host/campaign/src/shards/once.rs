//! Values that every task of a run needs, such as the best PID of a family: the first task computes one, the rest wait and read it.

use progress::Progress;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::RunFolder;
use crate::WorkspaceError;
use crate::claims::{Claims, State};
use data::provenance::build_id;
use data::workspace::same;

/// What a value is about.
#[derive(Serialize)]
struct About<'a, Q> {
    build: String,
    question: &'a Q,
}

/// A value in its file.
#[derive(Serialize, Deserialize)]
struct Kept<A, T> {
    about: A,
    value: T,
}

impl RunFolder {
    /// The value that the folder keeps under a name; computed and kept if there is none, by one of the tasks that ask. None if it was
    /// stopped before.
    ///
    /// # Errors
    /// A folder that cannot be used, a value of another question or build, or a computation that fails.
    pub fn once<Q: Serialize, T: Serialize + DeserializeOwned, E: From<WorkspaceError>>(
        &self,
        name: &str,
        question: &Q,
        progress: &Progress<'_>,
        compute: impl FnOnce() -> Result<T, E>,
    ) -> Result<Option<T>, E> {
        let claims = Claims::new(&self.claims_folder());
        loop {
            if let Some(found) = self.found(name, question)? {
                return Ok(Some(found));
            }
            if progress.stopped() {
                return Ok(None);
            }
            if claims.take(name)? == State::Mine {
                break;
            }
            std::thread::sleep(Claims::LOOK_EVERY);
        }
        let value = claims.renewed(|| self.kept_or(name, question, progress, compute));
        // Without a mark: the value itself shows that it is there.
        let released = claims.release(name, false);
        let value = value?;
        released?;
        Ok(value)
    }

    /// The value that the folder keeps under a name.
    ///
    /// # Errors
    /// A file that cannot be read, or that belongs to another question or build.
    pub fn found<T: DeserializeOwned>(
        &self,
        name: &str,
        question: &impl Serialize,
    ) -> Result<Option<T>, WorkspaceError> {
        let file = file_of(name);
        let Some(Kept { about, value }) = self.shards.load::<Kept<serde_json::Value, T>>(&file)? else {
            return Ok(None);
        };
        same(&self.shards.path(&file), &about, &About { build: build_id(), question })?;
        Ok(Some(value))
    }

    /// The value, computed by the task that holds its claim, unless the last holder has kept it just before.
    fn kept_or<Q: Serialize, T: Serialize + DeserializeOwned, E: From<WorkspaceError>>(
        &self,
        name: &str,
        question: &Q,
        progress: &Progress<'_>,
        compute: impl FnOnce() -> Result<T, E>,
    ) -> Result<Option<T>, E> {
        if let Some(found) = self.found(name, question)? {
            return Ok(Some(found));
        }
        let value = compute()?;
        if progress.stopped() {
            // It may be that of a computation that has ended early.
            return Ok(None);
        }
        let kept = Kept { about: About { build: build_id(), question }, value };
        self.shards.save_indented(&file_of(name), &kept)?;
        Ok(Some(kept.value))
    }
}

fn file_of(name: &str) -> String {
    format!("{name}.json")
}

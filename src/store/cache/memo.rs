//! Answers about files elsewhere that stand while these do not change. Knows nothing of what is
//! asked.

use std::path::PathBuf;

use artifacts_schema::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::Cache;
use super::index::Kind;
use super::signature::Signature;

impl Cache {
    /// The answer to a question about files: the one that the index remembers, if none of them has
    /// changed since; else it is asked.
    pub fn while_unchanged<T: Serialize + DeserializeOwned, E>(
        &self,
        question: &str,
        files: &[PathBuf],
        ask: impl FnOnce() -> Result<T, E>,
    ) -> Result<T, E> {
        // Before the answer is worked out: a file that changes meanwhile then has another signature
        // than the one that is kept.
        let now = self.clock.now();
        let Some(signatures) = files
            .iter()
            .map(|path| Signature::at(path))
            .collect::<Option<Vec<_>>>()
        else {
            // A file that is missing has nothing to be recognised by. What to say of it is for
            // `ask`.
            return ask();
        };
        let name = name(question, files);
        let state = digest(&signatures);
        if let Some((seen, answer)) = self.index.get::<(Digest, T)>(Kind::Answer, &name)
            && seen == state
        {
            return Ok(answer);
        }
        let answer = ask()?;
        // A file that changed a moment ago can change again within the same tick, and nobody would
        // see it.
        if signatures.iter().all(|signature| signature.is_settled(now)) {
            self.index.put(Kind::Answer, &name, &(state, &answer));
        }
        Ok(answer)
    }
}

fn name(question: &str, files: &[PathBuf]) -> Digest {
    // The same word means another file in another folder, so whole paths make the name.
    let whole = |path: &PathBuf| {
        let path = std::path::absolute(path).ok()?;
        // JSON holds text alone. Other paths are escaped in quotes, where no absolute path begins.
        Some(
            path.to_str()
                .map_or_else(|| format!("{path:?}"), str::to_owned),
        )
    };
    let whole: Vec<String> = files.iter().filter_map(whole).collect();
    digest(&(question, whole))
}

fn digest(content: &impl Serialize) -> Digest {
    blake3::hash(&serde_json::to_vec(content).unwrap_or_default()).into()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::fs::{self, File};
    use std::path::Path;
    use std::time::{Duration, SystemTime};

    use super::super::clock::Clock;
    use super::*;
    use crate::store::{Store, World};

    #[cfg(unix)]
    #[test]
    fn paths_that_are_no_text_have_answers_of_their_own() {
        use std::os::unix::ffi::OsStrExt;
        let file = |byte: u8| {
            vec![std::path::PathBuf::from(std::ffi::OsStr::from_bytes(&[
                byte,
            ]))]
        };
        assert_ne!(name("q", &file(0xff)), name("q", &file(0xfe)));
    }

    /// The answer to a question that is asked so long after the files were written.
    fn ask(root: &Path, files: &[PathBuf], answer: u32, after: Duration) -> u32 {
        let world = World {
            clock: Clock { ahead: after },
            ..World::default()
        };
        let cache = Store::create_in(world, root).unwrap().cache;
        let answer = cache
            .while_unchanged("q", files, || Ok::<_, Infallible>(answer))
            .unwrap();
        cache.keep();
        answer
    }

    /// Changed long ago, as far as its own time tells; when its inode changed, nobody can pretend.
    fn write(path: &Path, text: &str) {
        let before = Signature::at(path);
        // Two changes within one tick of the system's clock look like one.
        while fs::write(path, text).is_ok() && Signature::at(path) == before {}
        let long_ago = SystemTime::now() - Duration::from_secs(1000);
        File::options()
            .write(true)
            .open(path)
            .unwrap()
            .set_modified(long_ago)
            .unwrap();
    }

    #[test]
    fn an_answer_stands_until_a_file_changes() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["a", "b"].map(|name| folder.path().join(name));
        files.iter().for_each(|path| write(path, "1"));
        let root = folder.path().join("store");
        let at_once = Duration::ZERO;
        let later = Duration::from_secs(3);
        assert_eq!(ask(&root, &files, 1, at_once), 1);
        assert_eq!(
            ask(&root, &files, 2, at_once),
            2,
            "the files changed just now: another change would not show"
        );
        assert_eq!(ask(&root, &files, 3, later), 3);
        assert_eq!(ask(&root, &files, 4, later), 3);
        write(&files[1], "2");
        assert_eq!(
            ask(&root, &files, 5, later),
            5,
            "its time and size are as before, but not when its inode changed"
        );
        assert_eq!(
            ask(&root, &files[..1], 6, later),
            6,
            "another set of files is another question"
        );
        fs::remove_file(&files[0]).unwrap();
        assert_eq!(ask(&root, &files, 7, later), 7);
    }
}

//! Whether a stage goes on from a finished result that differs only in having fewer steps. Knows
//! nothing of what a state is.

use artifacts_schema::Digest;
use stages::Extension;

use crate::runner::explain::Reason;
use crate::store::manifest::Manifest;

/// The domain of extension keys; a new number when what is hashed changes.
const DOMAIN: &str = "srnerf-dag extension v1";

/// What results that differ in the number of steps alone have in common: the digest of all else in
/// their manifests. `None` where more steps cannot go on from fewer.
pub fn extension_key(extension: Extension, manifest: &Manifest) -> Option<Digest> {
    let Extension::Possible(field) = extension else {
        return None;
    };
    let mut hasher = blake3::Hasher::new_derive_key(DOMAIN);
    for (path, text) in manifest
        .0
        .iter()
        // The manifest is a map by path, so the order is the same in every run.
        .filter(|(path, _)| path.strip_prefix("params.") != Some(field))
    {
        // With the lengths, as in keys, so that texts cannot run into each other.
        for part in [path, text] {
            hasher
                .update(&(part.len() as u64).to_le_bytes())
                .update(part.as_bytes());
        }
    }
    Some(hasher.finalize().into())
}

/// Why a stage of which only the number of steps was raised begins with the first step all the
/// same.
pub fn obstacle(extension: Extension, reason: &Reason) -> Option<&'static str> {
    let (Extension::Impossible(field, why), Reason::Changed(changes)) = (extension, reason) else {
        return None;
    };
    // If anything else has changed as well, nobody expects the stage to go on.
    let [change] = changes.as_slice() else {
        return None;
    };
    let number = |text: &Option<String>| text.as_ref()?.parse::<u64>().ok();
    // Fewer steps cannot go on from more: nobody expects it.
    let raised = number(&change.before) < number(&change.now);
    (raised && change.path.strip_prefix("params.") == Some(field)).then_some(why)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runner::explain::Change;

    fn manifest(steps: &str, rate: &str) -> Manifest {
        Manifest(
            [("params.steps", steps), ("params.rate", rate)]
                .map(|(a, b)| (a.to_owned(), b.to_owned()))
                .into(),
        )
    }

    #[test]
    fn results_that_differ_in_steps_alone_have_one_extension_key() {
        let key = |steps, rate| {
            extension_key(Extension::Possible("steps"), &manifest(steps, rate)).unwrap()
        };
        assert_eq!(key("1", "0.1"), key("2", "0.1"));
        assert_ne!(key("1", "0.1"), key("1", "0.2"));
        assert_eq!(extension_key(Extension::None, &manifest("1", "0.1")), None);
        assert_eq!(
            extension_key(Extension::Impossible("steps", "so"), &manifest("1", "0.1")),
            None
        );
    }

    #[test]
    fn only_who_raised_the_steps_is_told_why_they_begin_anew() {
        let change = |path: &str, before: &str, now: &str| {
            let text = |text: &str| Some(text.to_owned());
            Change {
                path: path.into(),
                before: text(before),
                now: text(now),
                from: None,
            }
        };
        let told = |changes| {
            obstacle(
                Extension::Impossible("steps", "so"),
                &Reason::Changed(changes),
            )
        };
        assert_eq!(told(vec![change("params.steps", "9", "10")]), Some("so"));
        assert_eq!(told(vec![change("params.steps", "10", "9")]), None);
        assert_eq!(told(vec![change("params.rate", "9", "10")]), None);
        assert_eq!(
            told(vec![
                change("params.steps", "9", "10"),
                change("params.rate", "9", "10")
            ]),
            None
        );
        assert_eq!(obstacle(Extension::Possible("steps"), &Reason::New), None);
    }
}

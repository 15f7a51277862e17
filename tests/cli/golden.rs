//! A digest of what each stage kind gives for a small fixed input: when the output changes, so must
//! `VERSION`, or else stores would go on with results of the old code.
//!
//! `golden.json` holds them. Sums are cut into lanes, and lanes are as wide as the processor's: so
//! the operators are kept to AVX2 on x86-64, and there is a set for each architecture; one without
//! a set compares nothing, and says so. `make golden` writes the set of the processor it runs on,
//! and refuses an output that changed under the same version.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::space::Space;

/// What a stage was given and what it gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Golden {
    version: String,
    /// A digest of its manifest but for the version.
    recipe: String,
    /// The semantic digests of its outputs.
    outputs: BTreeMap<String, String>,
}

/// By level, then by kind.
type Table = BTreeMap<String, BTreeMap<String, Golden>>;

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/cli/golden.json")
}

/// The level of SIMD that is compared: one that nearly all processors of the kind have, so that all
/// compare the same.
fn level() -> String {
    #[cfg(target_arch = "x86_64")]
    let features = if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        "avx2"
    } else {
        "portable"
    };
    #[cfg(not(target_arch = "x86_64"))]
    let features = "portable";
    format!("{} {features}", std::env::consts::ARCH)
}

/// Runs a pipeline of every kind and collects what each gives.
fn now() -> BTreeMap<String, Golden> {
    let space = Space::new();
    let pipeline = format!("{}/tests/cli/golden.ron", env!("CARGO_MANIFEST_DIR"));
    let simd = level().split(' ').nth(1).unwrap().to_owned();
    let run = space
        .command(&["run", &pipeline, "--json"])
        .env("COMPUTE_SIMD", simd)
        .spawn()
        .unwrap();
    let ran = Space::wait(run).last()["ran"].clone();
    let golden = |stage: &Value| {
        let stage = stage.as_str().unwrap();
        let mut manifest =
            space.ok(&["explain", stage, &pipeline, "--json"]).json()["manifest"].clone();
        let mut entry = |name: &str| {
            manifest
                .as_object_mut()
                .unwrap()
                .remove(name)
                .unwrap()
                .as_str()
                .unwrap()
                .to_owned()
        };
        let kind = entry("kind");
        let version = entry("version");
        let outputs = space.ok(&["inspect", stage, &pipeline, "--json"]).json()["outputs"].clone();
        let digest = |(name, output): (&String, &Value)| {
            (name.clone(), output["digest"].as_str().unwrap().to_owned())
        };
        let outputs = outputs.as_object().unwrap().iter().map(digest).collect();
        let recipe = blake3::hash(manifest.to_string().as_bytes()).to_string();
        (
            kind,
            Golden {
                version,
                recipe,
                outputs,
            },
        )
    };
    ran.as_array().unwrap().iter().map(golden).collect()
}

#[test]
fn an_output_that_changes_raises_its_version() {
    let mut table: Table = serde_json::from_str(&std::fs::read_to_string(path()).unwrap()).unwrap();
    let now = now();
    for kind in stages::KINDS {
        assert!(
            now.contains_key(*kind),
            "golden.ron has no stage of the kind {kind}"
        );
    }
    let known = table.entry(level()).or_default();
    for (kind, golden) in &now {
        let same = known
            .get(kind)
            .filter(|old| (&old.recipe, &old.version) == (&golden.recipe, &golden.version));
        if let Some(old) = same {
            assert_eq!(
                old.outputs, golden.outputs,
                "{kind} gives something else than before: raise its VERSION"
            );
        }
    }
    if std::env::var_os("SRNERF_GOLDEN").is_some() {
        *known = now;
        std::fs::write(path(), format!("{:#}\n", serde_json::json!(table))).unwrap();
    } else if known.is_empty() {
        eprintln!(
            "golden.json has no digests for {}: nothing was compared; `make golden` adds them",
            level()
        );
    } else {
        let outdated: Vec<_> = now
            .iter()
            .filter(|(kind, golden)| known.get(*kind) != Some(golden))
            .map(|(k, _)| k)
            .collect();
        assert!(
            outdated.is_empty(),
            "golden.json is out of date for {outdated:?}: run `make golden`"
        );
    }
}

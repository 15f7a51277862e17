//! A store that machines share in a bucket, behind a server that does not always behave.

use std::collections::BTreeSet;
use std::time::Duration;

use serde_json::json;

use crate::files::assert_same_files;
use crate::remote::events;
use crate::s3::{Mood, S3};
use crate::space::{Said, Space};

/// A run on a machine of its own, with a bucket.
fn run_on(space: &Space, machine: &str, server: &S3) -> Said {
    let store = format!("--store={machine}/store");
    let out = format!("--out={machine}/out");
    let arguments = [
        "run",
        "tiny.ron",
        "--json",
        &store,
        &out,
        "--remote",
        "s3://bucket/team",
    ];
    let said = Space::wait(
        space
            .command(&arguments)
            .envs(server.environment())
            .spawn()
            .unwrap(),
    );
    assert_eq!(said.code, 0, "{}", said.err);
    said
}

#[test]
fn a_server_that_stumbles_is_asked_again() {
    let slow = Duration::from_millis(30);
    for mood in [
        Mood {
            errors: 9,
            ..Mood::default()
        },
        Mood {
            cuts: 4,
            ..Mood::default()
        },
        Mood {
            delay: slow,
            ..Mood::default()
        },
    ] {
        let space = Space::new();
        let server = S3::start(mood);
        let first = run_on(&space, "a", &server);
        assert_eq!(first.last()["ran"], json!(["again", "scene", "up"]));
        server.set(mood);
        let second = run_on(&space, "b", &server);
        assert_eq!(
            (
                events(&second, "fetched").len(),
                events(&second, "notice").len()
            ),
            (3, 0),
            "{mood:?}"
        );
        assert_same_files(&space, "a/out", "b/out");
    }
}

/// Everything else of a file that took an hour would have to be sent again with it.
#[test]
fn of_a_large_file_only_the_piece_that_failed_is_sent_again() {
    let space = Space::new();
    let large = "--set=again.factor=64";
    space.ok(&["run", "tiny.ron", "--store=a/store", large]);
    let server = S3::start(Mood {
        drops_pieces: true,
        ..Mood::default()
    });
    let push = ["store", "push", "s3://bucket/team", "--store=a/store"];
    let pushed = space.say_with(&server.environment(), &push);
    assert!(
        pushed.out.starts_with("pushed 3 results, "),
        "{}",
        pushed.err
    );
    let log = server.log();
    let uploads = log.iter().filter(|line| line.starts_with("POST "));
    let blobs: BTreeSet<&String> = uploads.clone().collect();
    assert!(!blobs.is_empty(), "no file is large");
    assert_eq!(
        uploads.count(),
        2 * blobs.len(),
        "begun once and ended once each"
    );
    let pull = ["store", "pull", "s3://bucket/team", "--store=b/store"];
    let pulled = space.say_with(&server.environment(), &pull);
    assert!(
        pulled.out.starts_with("pulled 3 results, "),
        "{}",
        pulled.err
    );
    assert_same_files(&space, "a/store/cas", "b/store/cas");
}

#[test]
fn of_two_that_put_one_result_the_first_wins() {
    let space = Space::new();
    let server = S3::start(Mood::default());
    space.ok(&["run", "tiny.ron", "--store=b/store", "--out=b/out"]);
    run_on(&space, "a", &server);
    let push = [
        "store",
        "push",
        "s3://bucket/team",
        "--store=b/store",
        "--json",
    ];
    let pushed = Space::wait(
        space
            .command(&push)
            .envs(server.environment())
            .spawn()
            .unwrap(),
    );
    assert_eq!(
        pushed.last(),
        json!({"event": "pushed", "results": 0, "bytes": 0})
    );
    let refused =
        |line: &&String| line.starts_with("PUT /bucket/team/results/") && line.ends_with(" 412");
    assert_eq!(server.log().iter().filter(refused).count(), 3);
    let pull = ["store", "pull", "s3://bucket/team", "--store=c/store"];
    let pulled = Space::wait(
        space
            .command(&pull)
            .envs(server.environment())
            .spawn()
            .unwrap(),
    );
    assert!(pulled.out.starts_with("pulled 3 results"), "{}", pulled.err);
}

#[test]
fn a_remote_cut_off_in_the_middle_is_missed_once_and_the_run_goes_on() {
    let space = Space::new();
    let server = S3::start(Mood {
        dies_after: Some(12),
        ..Mood::default()
    });
    let said = run_on(&space, "a", &server);
    assert_eq!(said.last()["ran"], json!(["again", "scene", "up"]));
    let notices = events(&said, "notice");
    assert_eq!(notices.len(), 1, "{notices:?}");
    assert!(
        notices[0]["text"]
            .as_str()
            .unwrap()
            .starts_with("s3://bucket/team: "),
        "{notices:?}"
    );
    server.set(Mood::default());
    run_on(&space, "a", &server);
    let push = ["store", "push", "s3://bucket/team", "--store=a/store"];
    assert!(
        Space::wait(
            space
                .command(&push)
                .envs(server.environment())
                .spawn()
                .unwrap()
        )
        .out
        .starts_with("pushed ")
    );
    assert_eq!(events(&run_on(&space, "b", &server), "fetched").len(), 3);
}

#[test]
fn credentials_are_never_printed() {
    let space = Space::new();
    let server = S3::start(Mood {
        always: Some(403),
        ..Mood::default()
    });
    let refused = run_on(&space, "a", &server);
    assert!(
        refused
            .out
            .contains("permission denied; going on without it"),
        "{}",
        refused.out
    );
    let in_the_address = space.say(&[
        "run",
        "tiny.ron",
        "--remote",
        "s3://the-id:the-secret@bucket/team",
    ]);
    assert_eq!(in_the_address.code, 2);
    assert!(
        in_the_address.err.contains("it holds credentials"),
        "{}",
        in_the_address.err
    );
    for said in [refused, in_the_address] {
        assert!(
            !(said.out + &said.err).contains("the-"),
            "a credential shows"
        );
    }
}

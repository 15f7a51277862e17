//! The page of `run --watch`: who is let in, and what it is told.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStderr, Stdio};
use std::time::Duration;

use crate::space::{Space, signal};

/// A field that trains until it is stopped.
const ENDLESS: &str = r#"(
    name: "endless",
    stages: {
        "scene": Scene(source: Procedural(views: 6, size: (16, 12)), downscale: 1, holdout: 3),
        "fit": Fit(images: "scene.train", steps: 10000000, samples: 256),
    },
)"#;

/// A run with a page.
struct Watched {
    run: Child,
    said: BufReader<ChildStderr>,
    host: String,
    token: String,
}

impl Watched {
    fn new(space: &Space) -> Self {
        std::fs::write(space.path("endless.ron"), ENDLESS).unwrap();
        let mut command = space.command(&["run", "endless.ron", "--watch", "--no-progress"]);
        let mut run = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(run.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("http://") {
            line.clear();
            assert!(
                said.read_line(&mut line).unwrap() > 0,
                "no address was told"
            );
        }
        let (_, address) = line.trim().split_once("http://").unwrap();
        let (host, token) = address.trim_end_matches('/').split_once('/').unwrap();
        Self {
            run,
            said,
            host: host.to_owned(),
            token: token.to_owned(),
        }
    }

    /// The connection on which the answer to a request comes.
    fn ask(&self, path: &str) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        let host = &self.host;
        // An answer that does not come fails the test.
        let patience = Some(Duration::from_secs(60));
        stream.set_read_timeout(patience).unwrap();
        let headers = format!("Host: {host}\r\nConnection: close");
        write!(stream, "GET {path} HTTP/1.1\r\n{headers}\r\n\r\n").unwrap();
        BufReader::new(stream)
    }

    fn status(&self, path: &str) -> String {
        let mut line = String::new();
        self.ask(path).read_line(&mut line).unwrap();
        line.split(' ').nth(1).unwrap().to_owned()
    }

    /// Reads on until a line contains `what`.
    fn until(answer: &mut impl BufRead, what: &str) -> String {
        let mut line = String::new();
        while !line.contains(what) {
            line.clear();
            assert!(answer.read_line(&mut line).unwrap() > 0, "no {what}");
        }
        line
    }
}

#[test]
fn a_page_is_told_what_happens() {
    let space = Space::new();
    let mut watched = Watched::new(&space);
    let token = watched.token.clone();
    let mut changes = watched.ask(&format!("/{token}/changes"));
    let whole = Watched::until(&mut changes, "\"names\"");
    assert!(whole.contains(r#""names":["scene","fit"]"#), "{whole}");
    let fit = Watched::until(&mut changes, r#""fit":{"curves":{"loss":[["#);
    assert!(fit.contains(r#""state":"running""#), "{fit}");
    let listed = format!("/{token}/pictures/scene");
    let mut listed = watched.ask(&listed);
    Watched::until(&mut listed, r#"{"output":"train","file":"view_001.exr"}"#);
    let picture = format!("/{token}/pictures/scene/train/view_001.exr");
    assert_eq!(watched.status(&picture), "200");
    // The user stops it: an open page keeps nobody waiting then.
    signal(&watched.run, "-INT");
    let mut rest = String::new();
    watched.said.read_to_string(&mut rest).unwrap();
    assert_eq!(watched.run.wait().unwrap().code(), Some(75), "{rest}");
}

#[test]
fn without_the_token_and_beside_the_stages_there_is_nothing() {
    let space = Space::new();
    let mut watched = Watched::new(&space);
    let token = watched.token.clone();
    std::fs::write(space.path("secret.png"), "none of the page's").unwrap();
    for path in [
        "/".to_owned(),
        format!("/{}/changes", "0".repeat(32)),
        format!("/{token}x/"),
        format!("/{token}/pictures/nobody"),
        format!("/{token}/pictures/.."),
        format!("/{token}/pictures/scene/../secret.png"),
        format!("/{token}/pictures/scene/%2e%2e/secret.png"),
        format!("/{token}/pictures/scene/..%2f..%2f..%2f/secret.png"),
        format!("/{token}/pictures/scene/train/..%2f..%2f..%2f..%2fsecret.png"),
        format!("/{token}/pictures/scene/train/transforms.json"),
    ] {
        assert_eq!(watched.status(&path), "404", "{path}");
    }
    assert_eq!(watched.status(&format!("/{token}/")), "200");
    watched.run.kill().unwrap();
    watched.run.wait().unwrap();
}

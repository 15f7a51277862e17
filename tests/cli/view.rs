//! Who is let in by `view`, and what malformed requests and clients that vanish do to it.

use std::io::Write;

use crate::space::{Said, signal};
use crate::viewer::{Viewer, fields, look, request};

#[test]
fn without_the_token_nothing_is_served() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    let host = viewer.host.as_str();
    let token = viewer.token.as_str();
    assert_eq!(token.len(), 32, "128 bits in hexadecimal digits");
    let last = if token.ends_with('0') { "1" } else { "0" };
    let paths = [
        "/".to_owned(),
        "/index.html".into(),
        "//".into(),
        format!("/{}/", &token[..31]),
        format!("/{}{last}/", &token[..31]),
        format!("/{token}0/"),
        format!("/{}/", token.to_uppercase().replace('0', "O")),
        format!("/x/{token}/"),
        format!("/?{token}"),
    ];
    for path in &paths {
        for method in ["GET", "POST", "OPTIONS"] {
            let answer = viewer.ask_as(method, path, &[("Host", host)], "");
            assert_eq!(
                (answer.status, answer.body.len()),
                (404, 0),
                "{method} {path}"
            );
        }
    }
    // Who knows the token, but comes by another name: a page elsewhere whose name leads here.
    let page = format!("/{token}/");
    let elsewhere = host.replace("127.0.0.1", "elsewhere.example");
    let origin = format!("http://{elsewhere}");
    for headers in [
        vec![("Host", elsewhere.as_str())],
        vec![],
        vec![("Host", "127.0.0.1")],
        vec![("Host", host), ("Origin", origin.as_str())],
        vec![("Host", host), ("Origin", "null")],
    ] {
        let answer = viewer.ask_as("GET", &page, &headers, "");
        assert_eq!((answer.status, answer.body.len()), (404, 0), "{headers:?}");
    }
    let local = host.replace("127.0.0.1", "localhost");
    for name in [host, &local] {
        let answer = viewer.ask_as("GET", &page, &[("Host", name)], "");
        assert_eq!(answer.status, 200, "{name}");
        assert!(answer.headers.contains("default-src 'none'"));
        assert!(answer.headers.contains("cache-control: no-store"));
        assert!(answer.headers.contains("referrer-policy: no-referrer"));
    }
}

#[test]
fn malformed_requests_are_refused_and_it_goes_on() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    let good = look(0, 16).to_string();
    let wrong = [
        ("\"photo\":0", "\"photo\":99"),
        ("\"photo\":0", "\"photo\":-1"),
        (
            "\"photo\":0",
            "\"free\":{\"like\":0,\"pose\":[[1,0,0,0],[0,1,0,0],[0,0,0,0]]}",
        ),
        (
            "\"photo\":0",
            "\"free\":{\"like\":0,\"pose\":[[1,0,0,1e999],[0,1,0,0],[0,0,1,0]]}",
        ),
        (
            "\"photo\":0",
            "\"free\":{\"like\":7,\"pose\":[[1,0,0,0],[0,1,0,0],[0,0,1,0]]}",
        ),
        ("\"width\":16", "\"width\":0"),
        ("\"width\":16", "\"width\":4294967295"),
        ("\"width\":16", "\"width\":5000"),
        ("\"width\":16", "\"width\":1e3"),
        ("\"color\"", "\"colour\""),
        ("\"field\":0", "\"field\":2"),
        ("\"moving\":false", "\"moving\":false,\"more\":1"),
        ("[{", "[[[[[[[[{"),
    ];
    for (from, to) in wrong {
        let body = good.replace(from, to);
        assert_ne!(body, good, "{from}");
        let answer = viewer.ask("POST", "look", &body);
        let said = String::from_utf8(answer.body).unwrap();
        assert_eq!(answer.status, 400, "{body}");
        assert!(!said.is_empty(), "{body}");
    }
    for cut in 0..good.len() {
        assert_eq!(viewer.ask("POST", "look", &good[..cut]).status, 400);
    }
    for body in [
        "{\"stands\":[]}",
        "{\"stands\":[{\"photo\":99}]}",
        "[]",
        "\u{0}",
    ] {
        assert_eq!(viewer.ask("POST", "path", body).status, 400, "{body}");
    }
    for (method, path, status) in [
        ("GET", "look", 405),
        ("POST", "", 405),
        ("GET", "nothing", 404),
        ("GET", "photo/99", 404),
        ("GET", "photo/x", 400),
        ("GET", "photo/..%2f..%2fetc%2fpasswd", 400),
        ("GET", "../../etc/passwd", 404),
        ("GET", &"x".repeat(300), 414),
        ("GET", &format!("?{}", "x".repeat(300)), 414),
    ] {
        assert_eq!(
            viewer.ask(method, path, "").status,
            status,
            "{method} {path}"
        );
    }
    let large = " ".repeat(5 << 20);
    assert!(
        !viewer
            .raw(&large.clone().into_bytes())
            .starts_with(b"HTTP/1.1 200")
    );
    let large = request(
        "POST",
        &format!("/{}/path", viewer.token),
        &[("Host", &viewer.host)],
        &large,
    );
    assert!(!viewer.raw(large.as_bytes()).starts_with(b"HTTP/1.1 200"));
    viewer.assert_alive();
}

/// Bytes are changed, cut off, put in and left out, all along the request.
#[test]
fn a_thousand_damaged_requests_leave_it_running() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    let path = format!("/{}/look", viewer.token);
    let good = request(
        "POST",
        &path,
        &[("Host", &viewer.host)],
        &look(0, 16).to_string(),
    );
    for round in 0..1000 {
        let mut bytes = good.clone().into_bytes();
        let at = round * 7919 % bytes.len();
        match round % 4 {
            0 => bytes[at] = (round * 31 % 256) as u8,
            1 => bytes.truncate(at),
            2 => bytes.insert(at, b'\r'),
            _ => {
                bytes.remove(at);
            }
        }
        let answer = viewer.raw(&bytes);
        assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."));
    }
    viewer.assert_alive();
}

#[test]
fn clients_that_vanish_leave_it_running() {
    let space = fields();
    let viewer = Viewer::new(&space, &[]);
    let path = format!("/{}/look", viewer.token);
    for _ in 0..40 {
        let mut stream = viewer.connect();
        let large = request(
            "POST",
            &path,
            &[("Host", &viewer.host)],
            &look(0, 2048).to_string(),
        );
        stream.write_all(large.as_bytes()).unwrap();
    }
    // One that says how much it will send, and does not.
    let mut silent = viewer.connect();
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: {}\r\nContent-Length: 99\r\n\r\n",
        viewer.host
    );
    silent.write_all(head.as_bytes()).unwrap();
    viewer.assert_alive();
}

#[test]
fn it_ends_when_it_is_interrupted_and_says_what_it_cannot_show() {
    let space = fields();
    let mut viewer = Viewer::new(&space, &["fields"]);
    signal(&viewer.child, "-INT");
    assert_eq!(viewer.child.wait().unwrap().code(), Some(0));
    for (what, expected) in [
        ("nothing", "`nothing` is no field, no run and no pipeline"),
        ("out/fields/scene/train", "field.safetensors"),
        (
            "out/fields/scene/train/transforms.json",
            "a field's file is called",
        ),
        ("@9", "`@9` is no field, no run and no pipeline"),
    ] {
        let Said { code, err, .. } = space.say(&["view", what]);
        assert_eq!(code, 2, "{err}");
        assert!(err.contains(expected), "{err}");
    }
}

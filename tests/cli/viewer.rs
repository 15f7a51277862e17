//! A running `view` and a client of it that is no browser: requests, answers, frames.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::process::Child;
use std::time::Duration;

use serde_json::{Value, json};

use crate::space::Space;

/// A field, one that went on from it, and renders of that.
pub const FIELDS: &str = r#"(
    name: "fields",
    stages: {
        "scene": Scene(
            source: Procedural(views: 4, size: (64, 48), samples: 1), downscale: 2, holdout: 4,
        ),
        "fit": Fit(images: "scene.train", steps: 20, samples: 4096),
        "up": Interpolate(images: "scene.train", factor: 2),
        "sync": Sync(field: "fit", images: "up", low_weight: 0, steps: 10, samples: 4096),
        "render": Render(field: "sync", cameras: "scene.train"),
    },
)"#;

/// A server in a space.
pub struct Viewer {
    pub child: Child,
    /// `127.0.0.1:PORT`.
    pub host: String,
    pub token: String,
    /// What it said of itself.
    pub said: Value,
}

/// What a server answers.
pub struct Answer {
    pub status: u16,
    pub headers: String,
    pub body: Vec<u8>,
}

/// A picture that a server sends.
pub struct Frame {
    pub head: Value,
    pub file: Vec<u8>,
}

/// A space in which that ran.
pub fn fields() -> Space {
    let space = Space::new();
    fs::write(space.path("fields.ron"), FIELDS).unwrap();
    space.ok(&["run", "fields.ron", "--device", "cpu"]);
    space
}

impl Viewer {
    pub fn new(space: &Space, what: &[&str]) -> Self {
        let arguments = [&["view", "--json", "--device", "cpu"], what].concat();
        let mut child = space.spawn(&arguments);
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let url = said["url"].as_str().unwrap().to_owned();
        let parts: Vec<&str> = url.split('/').collect();
        assert_eq!((parts[0], parts[4], parts.len()), ("http:", "", 5), "{url}");
        Self {
            child,
            host: parts[2].to_owned(),
            token: parts[3].to_owned(),
            said,
        }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.host).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(120)))
            .unwrap();
        stream
    }

    /// Sends bytes as they are; what comes back, which may be nothing.
    pub fn raw(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = self.connect();
        let mut answer = Vec::new();
        // Who is refused early may find the connection closed.
        let _ = stream.write_all(bytes);
        let _ = stream.shutdown(Shutdown::Write);
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Asks for a path under the token's, as HTTP/1.0 does: the answer ends with the connection.
    pub fn ask(&self, method: &str, path: &str, body: &str) -> Answer {
        let path = format!("/{}/{path}", self.token);
        self.ask_as(method, &path, &[("Host", &self.host)], body)
    }

    pub fn ask_as(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Answer {
        let mut stream = self.connect();
        stream
            .write_all(request(method, path, headers, body).as_bytes())
            .unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        Answer::read(&bytes)
    }

    pub fn frames(&self, look: &Value) -> Vec<Frame> {
        let answer = self.ask("POST", "look", &look.to_string());
        let said = String::from_utf8_lossy(&answer.body);
        assert_eq!(answer.status, 200, "{said}");
        frames(&answer.body)
    }

    /// That it still does what it is there for.
    pub fn assert_alive(&self) {
        assert_eq!(self.ask("GET", "", "").status, 200);
        let last = self.frames(&look(0, 16)).pop().unwrap();
        assert_eq!(
            (&last.head["part"], &last.head["rays"]),
            (&json!(1), &json!(2))
        );
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A request of HTTP/1.0, whose answer ends with its connection.
pub fn request(method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> String {
    let headers: String = headers
        .iter()
        .map(|(name, value)| format!("{name}: {value}\r\n"))
        .collect();
    let length = body.len();
    format!("{method} {path} HTTP/1.0\r\n{headers}Content-Length: {length}\r\n\r\n{body}")
}

impl Answer {
    pub fn read(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
        let (head, body) = bytes.split_at(end.unwrap() + 4);
        let headers = String::from_utf8(head.to_vec()).unwrap();
        Self {
            status: headers.split(' ').nth(1).unwrap().parse().unwrap(),
            headers: headers.to_lowercase(),
            body: body.to_vec(),
        }
    }
}

/// Frames lie one behind the other: a line of JSON, then the bytes of a picture.
pub fn frames(mut bytes: &[u8]) -> Vec<Frame> {
    let mut frames = Vec::new();
    while !bytes.is_empty() {
        let end = bytes.iter().position(|&byte| byte == b'\n').unwrap();
        let head: Value = serde_json::from_slice(&bytes[..end]).unwrap();
        let (file, rest) = bytes[end + 1..].split_at(head["bytes"].as_u64().unwrap() as usize);
        frames.push(Frame {
            head,
            file: file.to_vec(),
        });
        bytes = rest;
    }
    frames
}

/// A look from a photo at the first field.
pub fn look(photo: usize, width: u32) -> Value {
    let panes = [json!({"field": 0, "show": "color"})];
    json!({"stand": {"photo": photo}, "width": width, "panes": panes, "moving": false})
}

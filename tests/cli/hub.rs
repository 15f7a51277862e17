//! A hub of one model on this machine: as much of the Hugging Face hub's protocol as a download
//! needs.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use sha1::Sha1;
use sha2::{Digest, Sha256};

/// A running hub; its threads end with the test's process.
pub struct Hub {
    port: u16,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    folder: PathBuf,
    /// The file of which only half is sent.
    cut_off: Option<String>,
    /// Each file that was asked for, and from which byte on.
    downloads: Vec<(String, usize)>,
}

impl Hub {
    /// Serves `folder` as the model `owner/tiny`.
    pub fn new(folder: &Path) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let state = Arc::new(Mutex::new(State {
            folder: folder.to_owned(),
            ..State::default()
        }));
        let shared = state.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().map(Result::unwrap) {
                let shared = shared.clone();
                std::thread::spawn(move || answer(stream, &shared));
            }
        });
        Self { port, state }
    }

    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    pub fn cut_off(&self, file: &str) {
        self.state.lock().unwrap().cut_off = Some(file.to_owned());
    }

    pub fn serve_all(&self) {
        self.state.lock().unwrap().cut_off = None;
    }

    /// Whether a download of `file` began after its first byte.
    pub fn resumed(&self, file: &str) -> bool {
        self.state
            .lock()
            .unwrap()
            .downloads
            .iter()
            .any(|(name, start)| name == file && *start > 0)
    }

    pub fn downloads(&self) -> usize {
        self.state.lock().unwrap().downloads.len()
    }
}

fn answer(mut stream: TcpStream, state: &Mutex<State>) -> Option<()> {
    let mut lines = BufReader::new(stream.try_clone().ok()?).lines();
    let path = lines.next()?.ok()?.split(' ').nth(1)?.to_owned();
    let headers: Vec<String> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.is_empty())
        .collect();
    if path.starts_with("/api/models/owner/tiny") {
        let body = listing(&state.lock().unwrap().folder);
        let head = format!(
            "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {}\r\n",
            body.len()
        );
        return stream
            .write_all(format!("{head}Connection: close\r\n\r\n{body}").as_bytes())
            .ok();
    }
    let name = path.strip_prefix("/owner/tiny/resolve/main/")?;
    let range = headers.iter().find_map(|line| {
        line.to_lowercase()
            .strip_prefix("range: bytes=")
            .map(str::to_owned)
    })?;
    let (head, body) = state.lock().unwrap().part(name, &range)?;
    stream.write_all(head.as_bytes()).ok()?;
    stream.write_all(&body).ok()
}

impl State {
    /// The head and the body of the answer to a request for a range of a file.
    fn part(&mut self, name: &str, range: &str) -> Option<(String, Vec<u8>)> {
        let bytes = fs::read(self.folder.join(name)).ok()?;
        let (start, end) = range.split_once('-')?;
        let start: usize = start.parse().ok()?;
        let end = end.parse::<usize>().map_or(bytes.len(), |last| last + 1);
        if range != "0-0" {
            self.downloads.push((name.to_owned(), start));
        }
        let mut body = bytes[start..end].to_vec();
        let head = format!(
            "HTTP/1.1 206 Partial Content\r\nX-Repo-Commit: {}\r\nETag: \"{}\"\r\nContent-Range: bytes {start}-{}/{}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            "c0ffee".repeat(6),
            tag(name, &bytes),
            end - 1,
            bytes.len(),
            body.len()
        );
        if self.cut_off.as_deref() == Some(name) && range != "0-0" {
            body.truncate(body.len() / 2);
        }
        Some((head, body))
    }
}

/// SHA-256 for weights; for all else the SHA-1 that git has.
fn tag(name: &str, bytes: &[u8]) -> String {
    let hex = |digest: &[u8]| digest.iter().map(|byte| format!("{byte:02x}")).collect();
    match name.ends_with(".safetensors") {
        true => hex(&Sha256::digest(bytes)),
        false => hex(&Sha1::digest(
            [format!("blob {}\0", bytes.len()).as_bytes(), bytes].concat(),
        )),
    }
}

fn listing(folder: &Path) -> String {
    let files = walkdir::WalkDir::new(folder)
        .into_iter()
        .map(Result::unwrap)
        .filter(|entry| entry.file_type().is_file());
    let name = |entry: walkdir::DirEntry| {
        entry
            .path()
            .strip_prefix(folder)
            .unwrap()
            .to_string_lossy()
            .into_owned()
    };
    let siblings: Vec<_> = files
        .map(|entry| serde_json::json!({"rfilename": name(entry)}))
        .collect();
    serde_json::json!({"sha": "c0ffee".repeat(6), "siblings": siblings}).to_string()
}

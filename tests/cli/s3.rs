//! A server that speaks just enough S3 for a store, and misbehaves as it is told. One request per
//! connection.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How the server treats what is to come.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mood {
    /// How many requests it answers with 500, every second one.
    pub errors: u32,
    /// How many downloads it cuts off half-way, every second one.
    pub cuts: u32,
    /// How long it takes to answer.
    pub delay: Duration,
    /// The status of all answers, where it has made up its mind.
    pub always: Option<u16>,
    /// Whether it answers with 500 when it first gets a piece of an upload.
    pub drops_pieces: bool,
    /// After how many requests it hangs up on everyone, for good.
    pub dies_after: Option<u32>,
}

/// A bucket on a port of this machine.
#[derive(Clone, Default)]
pub struct S3 {
    objects: Arc<Mutex<BTreeMap<String, Vec<u8>>>>,
    mood: Arc<Mutex<Mood>>,
    log: Arc<Mutex<Vec<String>>>,
    /// The pieces that it got once at least.
    pieces: Arc<Mutex<BTreeSet<String>>>,
    port: u16,
}

struct Request {
    method: String,
    path: String,
    query: String,
    headers: BTreeMap<String, String>,
    body: Vec<u8>,
}

struct Answer {
    status: u16,
    headers: String,
    body: Vec<u8>,
}

impl S3 {
    /// A server in this mood, with an empty bucket.
    pub fn start(mood: Mood) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = Self {
            mood: Arc::new(Mutex::new(mood)),
            port,
            ..Self::default()
        };
        let serving = server.clone();
        std::thread::spawn(move || {
            for connection in listener.incoming().flatten() {
                let serving = serving.clone();
                std::thread::spawn(move || serving.serve(connection));
            }
        });
        server
    }

    /// Another mood from now on.
    pub fn set(&self, mood: Mood) {
        *self.mood.lock().unwrap() = mood;
    }

    /// What a client must have in its environment.
    pub fn environment(&self) -> Vec<(&'static str, String)> {
        vec![
            ("AWS_ENDPOINT", format!("http://127.0.0.1:{}", self.port)),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_ACCESS_KEY_ID", "the-id".into()),
            ("AWS_SECRET_ACCESS_KEY", "the-secret".into()),
        ]
    }

    /// All requests so far, with what was answered: `PUT /bucket/results/.. 412`.
    pub fn log(&self) -> Vec<String> {
        self.log.lock().unwrap().clone()
    }

    fn serve(&self, mut connection: TcpStream) {
        let Some(request) = Request::read(&mut connection) else {
            return;
        };
        let Some((mood, cut)) = self.next_mood(&request) else {
            return;
        };
        std::thread::sleep(mood.delay);
        let answer = match mood.always {
            Some(status) => {
                Answer::new(status, "<Error><StringToSign>the-id</StringToSign></Error>")
            }
            None if mood.drops_pieces && self.is_new_piece(&request) => Answer::new(500, ""),
            None => self.answer(&request),
        };
        self.log.lock().unwrap().push(format!(
            "{} {} {}",
            request.method, request.path, answer.status
        ));
        let length = if request.method == "HEAD" {
            answer.headers.clone()
        } else {
            answer.length()
        };
        let head = format!(
            "HTTP/1.1 {} X\r\nConnection: close\r\nETag: \"e\"\r\n{length}\r\n",
            answer.status
        );
        let body = if cut {
            &answer.body[..answer.body.len() / 2]
        } else {
            &answer.body[..]
        };
        let body = if request.method == "HEAD" { &[] } else { body };
        // A client that has hung up does not want the answer.
        let _ = connection
            .write_all(head.as_bytes())
            .and_then(|()| connection.write_all(body));
    }

    /// The mood for one request, and whether its answer is cut off; `None` if the server is dead.
    fn next_mood(&self, request: &Request) -> Option<(Mood, bool)> {
        let mut mood = self.mood.lock().unwrap();
        if let Some(left) = &mut mood.dies_after {
            *left = left.checked_sub(1)?;
        }
        let mut now = *mood;
        if mood.errors > 0 {
            mood.errors -= 1;
            now.always = mood.errors.is_multiple_of(2).then_some(500);
        }
        let download = request.method == "GET" && request.path.contains("/cas/");
        if download && mood.cuts > 0 {
            mood.cuts -= 1;
        }
        Some((now, download && now.cuts % 2 == 1))
    }

    fn is_new_piece(&self, request: &Request) -> bool {
        let name = || format!("{}?{}", request.path, request.query);
        request.query.starts_with("partNumber=") && self.pieces.lock().unwrap().insert(name())
    }

    fn answer(&self, request: &Request) -> Answer {
        let mut objects = self.objects.lock().unwrap();
        match (request.method.as_str(), objects.get(&request.path)) {
            ("POST", _) if request.query.starts_with("uploads") => {
                let id = "<UploadId>1</UploadId>";
                let head = "<Bucket>bucket</Bucket><Key>k</Key>";
                Answer::new(
                    200,
                    &format!(
                        "<InitiateMultipartUploadResult>{head}{id}</InitiateMultipartUploadResult>"
                    ),
                )
            }
            ("POST", _) => {
                let name = format!("{}?", request.path);
                let is_piece = |path: &String| path.starts_with(&name);
                let pieces: Vec<String> = objects
                    .keys()
                    .filter(|path| is_piece(path))
                    .cloned()
                    .collect();
                let whole = pieces
                    .iter()
                    .flat_map(|piece| objects.remove(piece).unwrap())
                    .collect();
                objects.insert(request.path.clone(), whole);
                Answer::new(
                    200,
                    "<CompleteMultipartUploadResult><ETag>e</ETag></CompleteMultipartUploadResult>",
                )
            }
            ("PUT", _) if request.query.starts_with("partNumber=") => {
                objects.insert(
                    format!("{}?{}", request.path, request.query),
                    request.body.clone(),
                );
                Answer::new(200, "")
            }
            ("PUT", Some(_)) if request.headers.contains_key("if-none-match") => {
                Answer::new(412, "")
            }
            ("PUT", _) => {
                objects.insert(request.path.clone(), request.body.clone());
                Answer::new(200, "")
            }
            ("GET", _) if request.query.contains("list-type=2") => list(&objects, &request.query),
            ("GET" | "HEAD", Some(bytes)) => request.part_of(bytes),
            _ => Answer::new(404, ""),
        }
    }
}

impl Request {
    fn read(connection: &mut TcpStream) -> Option<Self> {
        let mut bytes = Vec::new();
        let mut one = [0];
        while !bytes.ends_with(b"\r\n\r\n") {
            connection.read_exact(&mut one).ok()?;
            bytes.push(one[0]);
        }
        let text = String::from_utf8(bytes).ok()?;
        let mut lines = text.lines();
        let mut first = lines.next()?.split(' ');
        let method = first.next()?.to_owned();
        let target = first.next()?;
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let header = |line: &str| {
            line.split_once(": ")
                .map(|(name, value)| (name.to_lowercase(), value.to_owned()))
        };
        let headers: BTreeMap<String, String> = lines.filter_map(header).collect();
        let mut body = vec![
            0;
            headers
                .get("content-length")
                .map_or(0, |length| length.parse().unwrap())
        ];
        connection.read_exact(&mut body).ok()?;
        Some(Self {
            method,
            path: path.to_owned(),
            query: query.to_owned(),
            headers,
            body,
        })
    }

    /// As much of an object as was asked for.
    fn part_of(&self, bytes: &[u8]) -> Answer {
        let length = bytes.len();
        let Some(range) = self
            .headers
            .get("range")
            .and_then(|range| range.strip_prefix("bytes="))
        else {
            return Answer {
                status: 200,
                headers: format!("Content-Length: {length}\r\n"),
                body: bytes.to_vec(),
            };
        };
        let (first, last) = range.split_once('-').unwrap();
        let first = first.parse::<usize>().unwrap();
        let last = last.parse::<usize>().unwrap().min(length - 1);
        let headers = format!("Content-Range: bytes {first}-{last}/{length}\r\n");
        Answer {
            status: 206,
            headers,
            body: bytes[first..=last].to_vec(),
        }
    }
}

impl Answer {
    fn new(status: u16, body: &str) -> Self {
        Self {
            status,
            headers: String::new(),
            body: body.as_bytes().to_vec(),
        }
    }

    fn length(&self) -> String {
        let others = if self.headers.starts_with("Content-Length") {
            ""
        } else {
            &self.headers
        };
        format!("{others}Content-Length: {}\r\n", self.body.len())
    }
}

fn list(objects: &BTreeMap<String, Vec<u8>>, query: &str) -> Answer {
    let prefix = query
        .split('&')
        .find_map(|part| part.strip_prefix("prefix="))
        .unwrap_or("")
        .replace("%2F", "/");
    let entry = |(path, bytes): (&String, &Vec<u8>)| {
        let key = path.trim_start_matches("/bucket/");
        let size = bytes.len();
        let date = "2026-01-01T00:00:00.000Z";
        let fields = format!(
            "<Key>{key}</Key><Size>{size}</Size><LastModified>{date}</LastModified><ETag>e</ETag>"
        );
        key.starts_with(&prefix)
            .then(|| format!("<Contents>{fields}</Contents>"))
    };
    let entries: String = objects.iter().filter_map(entry).collect();
    Answer::new(
        200,
        &format!("<ListBucketResult><IsTruncated>false</IsTruncated>{entries}</ListBucketResult>"),
    )
}

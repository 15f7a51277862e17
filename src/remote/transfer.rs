//! Results over the wire: records and manifests whole, blobs piece by piece, their digests taken on
//! the way.

use std::fs::File;
use std::io::{Read, Write};
use std::sync::Arc;

use artifacts_schema::Digest;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutMode, PutMultipartOptions, PutPayload};

use super::Remote;
use super::fault::RemoteFault;
use crate::store::Store;
use crate::store::error::At;
use crate::store::files::place;
use crate::store::record::{Record, StoredFile};

/// Blobs travel in pieces of this size, so that none is ever whole in memory and no request takes
/// long.
const PIECE: u64 = 8 << 20;

/// How many blobs travel at once.
const AT_ONCE: usize = 8;

/// A record or manifest above this size is none.
const LARGEST_RECORD: u64 = 64 << 20;

impl Remote {
    fn path(&self, folder: &str, digest: &Digest, extension: &str) -> Path {
        let inside = place(folder, digest, extension);
        self.root
            .parts()
            .chain(Path::from(inside).parts())
            .collect()
    }

    /// A result that is there with all its blobs; whether their bytes are right is known once they
    /// are fetched.
    pub(super) async fn find(&self, key: &Digest) -> Result<Option<Record>, RemoteFault> {
        let Some(record) = self.record(key).await? else {
            return Ok(None);
        };
        // Asked for here, since the plan counts such a result as there: one without its blobs would
        // be found out hours later.
        self.each_file(&record, async |name, file| {
            match self.size(&file.blob).await? {
                Some(bytes) if bytes == file.bytes => Ok(0),
                Some(_) => Err(RemoteFault::Damaged(format!("blob damaged: {name}"))),
                None => Err(RemoteFault::Damaged(format!("blob missing: {name}"))),
            }
        })
        .await?;
        Ok(Some(record))
    }

    /// Fetches a result into the local store: blobs first, the record last. Answers how many bytes
    /// came.
    pub(super) async fn bring(
        &self,
        store: &Store,
        key: &Digest,
    ) -> Result<Option<(Record, u64)>, RemoteFault> {
        let Some(record) = self.find(key).await? else {
            return Ok(None);
        };
        let bytes = self
            .each_file(&record, async |name, file| {
                self.bring_blob(store, &name, file).await
            })
            .await?;
        // A manifest that is absent or garbled does no harm: only explanations need it.
        let manifest = self.small(&self.path("manifests", key, ".json")).await?;
        if let Some(manifest) = manifest.and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
            store.manifests.put(key, &manifest)?;
        }
        // What lies here is absent or damaged, else nobody would have asked: a damaged record has
        // to give way.
        Ok(Some((store.results.put(record, true)?, bytes)))
    }

    async fn bring_blob(
        &self,
        store: &Store,
        name: &str,
        file: &StoredFile,
    ) -> Result<u64, RemoteFault> {
        // Results share blobs, and a fetch that was cut off has brought some already.
        if store.blobs.check(&file.blob)?.is_none() {
            return Ok(0);
        }
        let path = self.path("cas", &file.blob, "");
        let receiving = store.blobs.receiving()?;
        let mut received = File::options()
            .append(true)
            .open(&receiving)
            .at("write", &receiving)?;
        let mut hasher = blake3::Hasher::new();
        let mut at = 0;
        while at < file.bytes {
            let range = at..file.bytes.min(at + PIECE);
            let piece = self
                .retry
                .ask(async || Ok(self.objects.get_range(&path, range.clone()).await?))
                .await?;
            hasher.update(&piece);
            received.write_all(&piece).at("write", &receiving)?;
            at = range.end;
        }
        // Nothing that comes from outside gets into `cas/` before its bytes have proved its name.
        if Digest::from(hasher.finalize()) != file.blob {
            return Err(RemoteFault::Damaged(format!("blob damaged: {name}")));
        }
        store.blobs.keep(&receiving)?;
        Ok(file.bytes)
    }

    /// Puts a result there: blobs first, the record last and only if there is none. `replace` puts
    /// everything there whatever there is. Answers whether the record is new, and how many bytes of
    /// blobs went.
    pub(super) async fn send(
        &self,
        store: &Store,
        record: &Record,
        replace: bool,
    ) -> Result<(bool, u64), RemoteFault> {
        let sent = self.each_file(record, async |_, file| {
            // A blob's name is its digest, so its size is enough to tell a whole one from one that
            // was cut short.
            let there = !replace && self.size(&file.blob).await? == Some(file.bytes);
            if there {
                Ok(0)
            } else {
                self.send_blob(store, file).await
            }
        });
        let bytes = sent.await?;
        if let Some(manifest) = store.manifests.get(&record.key) {
            let path = self.path("manifests", &record.key, ".json");
            // Never replaced: a manifest of the same key says the same.
            self.put(&path, serde_json::to_vec_pretty(&manifest), PutMode::Create)
                .await?;
        }
        // The record comes last, so that whoever sees it can count on the blobs. The first of two
        // senders wins, as in the local store.
        let mode = if replace {
            PutMode::Overwrite
        } else {
            PutMode::Create
        };
        let path = self.path("results", &record.key, ".json");
        Ok((
            self.put(&path, serde_json::to_vec_pretty(record), mode)
                .await?,
            bytes,
        ))
    }

    async fn send_blob(&self, store: &Store, file: &StoredFile) -> Result<u64, RemoteFault> {
        let from = store.blobs.path(&file.blob);
        let to = self.path("cas", &file.blob, "");
        // An upload in pieces takes several requests more, which small files do not repay.
        let send = async || match file.bytes {
            0..=PIECE => {
                let bytes = std::fs::read(&from).at("read", &from)?;
                self.objects.put(&to, bytes.into()).await?;
                Ok(())
            }
            _ => self.send_in_pieces(&from, &to).await,
        };
        self.retry.ask(send).await?;
        Ok(file.bytes)
    }

    async fn send_in_pieces(&self, from: &std::path::Path, to: &Path) -> Result<(), RemoteFault> {
        let mut file = File::open(from).at("read", from)?;
        // S3 takes parts of 5 MiB and more, and at most 10 000 of them: pieces of this size make 80
        // GB.
        let options = PutMultipartOptions::default().with_retry_policy(Arc::new(self.retry));
        let mut upload = self.objects.put_multipart_opts(to, options).await?;
        loop {
            let mut piece = Vec::new();
            Read::by_ref(&mut file)
                .take(PIECE)
                .read_to_end(&mut piece)
                .at("read", from)?;
            if piece.is_empty() {
                break;
            }
            if let Err(error) = upload.put_part(piece.into()).await {
                // What was sent is worth nothing now; if it cannot be taken back either, the
                // service's own rules do.
                let _ = upload.abort().await;
                return Err(error.into());
            }
        }
        upload.complete().await?;
        Ok(())
    }

    /// Puts a small object there; false if it was there and should stay.
    async fn put(
        &self,
        path: &Path,
        bytes: serde_json::Result<Vec<u8>>,
        mode: PutMode,
    ) -> Result<bool, RemoteFault> {
        let bytes =
            PutPayload::from(bytes.map_err(|error| RemoteFault::Damaged(error.to_string()))?);
        let put = async || match self
            .objects
            .put_opts(path, bytes.clone(), mode.clone().into())
            .await
        {
            Ok(_) => Ok(true),
            // Another sender's, or our own first attempt whose answer was lost: a record is there.
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        };
        self.retry.ask(put).await
    }

    async fn record(&self, key: &Digest) -> Result<Option<Record>, RemoteFault> {
        let Some(bytes) = self.small(&self.path("results", key, ".json")).await? else {
            return Ok(None);
        };
        match serde_json::from_slice::<Record>(&bytes) {
            Ok(record) if record.is_of(key) => Ok(Some(record)),
            _ => Err(RemoteFault::Damaged(format!(
                "the record of {key} is not one"
            ))),
        }
    }

    /// A small object, if it is there.
    async fn small(&self, path: &Path) -> Result<Option<Vec<u8>>, RemoteFault> {
        let get = async || {
            let found = self.objects.get(path).await?;
            match found.meta.size {
                // The size is looked at before the body is read: a wrong object must not fill the
                // memory.
                0..=LARGEST_RECORD => Ok(found.bytes().await?.to_vec()),
                bytes => Err(RemoteFault::Damaged(format!("{path} has {bytes} bytes"))),
            }
        };
        absent(self.retry.ask(get).await)
    }

    async fn size(&self, blob: &Digest) -> Result<Option<u64>, RemoteFault> {
        let path = self.path("cas", blob, "");
        absent(
            self.retry
                .ask(async || Ok(self.objects.head(&path).await?.size))
                .await,
        )
    }

    /// The keys of all results that are there, in order.
    pub(super) async fn keys(&self) -> Result<Vec<Digest>, RemoteFault> {
        let results: Path = self
            .root
            .parts()
            .chain(Path::from("results").parts())
            .collect();
        let list = async || {
            Ok(self
                .objects
                .list(Some(&results))
                .try_collect::<Vec<_>>()
                .await?)
        };
        let found = self.retry.ask(list).await?;
        let key = |path: &Path| path.filename()?.strip_suffix(".json")?.parse().ok();
        let mut keys: Vec<Digest> = found
            .iter()
            .filter_map(|object| key(&object.location))
            .collect();
        // Services list in an order of their own.
        keys.sort_unstable();
        Ok(keys)
    }

    /// Does something with every file of a result, several at once; the sum of the answers.
    async fn each_file(
        &self,
        record: &Record,
        act: impl AsyncFn(String, &StoredFile) -> Result<u64, RemoteFault>,
    ) -> Result<u64, RemoteFault> {
        let files = record
            .files()
            .map(|(output, file)| act(format!("{output}/{}", file.path), file));
        stream::iter(files)
            // In any order: only the sum counts, and the first fault ends all.
            .buffer_unordered(AT_ONCE)
            .try_fold(0, async |sum, bytes| Ok(sum + bytes))
            .await
    }
}

/// What is not there is no fault.
fn absent<T>(answer: Result<T, RemoteFault>) -> Result<Option<T>, RemoteFault> {
    match answer {
        Ok(found) => Ok(Some(found)),
        Err(RemoteFault::Remote(object_store::Error::NotFound { .. })) => Ok(None),
        Err(fault) => Err(fault),
    }
}

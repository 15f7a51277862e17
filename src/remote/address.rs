//! From an address to a client: which service, which bucket, which folder of it. Credentials come
//! from the environment alone.

use object_store::aws::AmazonS3Builder;
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ObjectStore, RetryConfig};
use url::Url;

/// An address that leads nowhere.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("the remote {address} cannot be used: {problem}")]
#[diagnostic(help(
    "addresses are s3://BUCKET/FOLDER, gs://BUCKET/FOLDER, az://CONTAINER/FOLDER, file:///FOLDER, or a folder"
))]
pub struct AddressError {
    address: String,
    problem: String,
}

impl AddressError {
    pub(super) fn new(address: &str, problem: impl Into<String>) -> Self {
        Self {
            address: address.to_owned(),
            problem: problem.into(),
        }
    }
}

/// What every service's client has in common: [`super::retry`] asks again, the client itself does
/// not.
fn once() -> RetryConfig {
    RetryConfig {
        max_retries: 0,
        ..RetryConfig::default()
    }
}

/// The client for an address, and the folder in it. Nothing is asked of the service.
pub fn open(address: &str) -> Result<(Box<dyn ObjectStore>, Path), AddressError> {
    // A folder is taken as it is: its name may hold characters that mean something in an address.
    if !address.contains("://") {
        return folder(address, std::path::Path::new(address));
    }
    let url = Url::parse(address).map_err(|error| AddressError::new(address, error.to_string()))?;
    // Command lines are seen by others and kept with each run. In `abfss` the part before the @ is
    // the container.
    if url.password().is_some() || (!url.username().is_empty() && url.scheme() != "abfss") {
        // The message goes to logs: it must not repeat what it warns of.
        let hidden = format!("{}://..", url.scheme());
        return Err(AddressError::new(
            &hidden,
            "it holds credentials; put them into the environment",
        ));
    }
    let root = Path::from_url_path(url.path())
        .map_err(|error| AddressError::new(address, error.to_string()))?;
    // Only one provider of TLS is built in; a second call, which finds it chosen, changes nothing.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let client: Result<Box<dyn ObjectStore>, object_store::Error> = match url.scheme() {
        "file" => {
            return folder(
                address,
                &url.to_file_path()
                    .map_err(|()| AddressError::new(address, "it is no path"))?,
            );
        }
        "s3" => AmazonS3Builder::from_env()
            .with_url(address)
            .with_retry(once())
            .build()
            .map(boxed),
        "gs" => GoogleCloudStorageBuilder::from_env()
            .with_url(address)
            .with_retry(once())
            .build()
            .map(boxed),
        "az" | "abfss" => MicrosoftAzureBuilder::from_env()
            .with_url(address)
            .with_retry(once())
            .build()
            .map(boxed),
        other => {
            return Err(AddressError::new(
                address,
                format!("there is no `{other}` here"),
            ));
        }
    };
    let client = client.map_err(|error| AddressError::new(address, error.to_string()))?;
    Ok((client, root))
}

fn boxed<S: ObjectStore>(store: S) -> Box<dyn ObjectStore> {
    Box::new(store)
}

/// A folder, which the first thing that is written there makes.
fn folder(
    address: &str,
    path: &std::path::Path,
) -> Result<(Box<dyn ObjectStore>, Path), AddressError> {
    let refused = |problem: String| AddressError::new(address, problem);
    if path.exists() && !path.is_dir() {
        return Err(refused("it is no folder".into()));
    }
    let whole = std::path::absolute(path).map_err(|error| refused(error.to_string()))?;
    let root = Path::from_absolute_path(whole).map_err(|error| refused(error.to_string()))?;
    // Flushed like a store of our own, since others rely on what they find there.
    Ok((boxed(LocalFileSystem::new().with_fsync(true)), root))
}

//! The GPUs of this machine, and which one to take. It knows drivers and limits, not kernels.

use super::error::GpuError;
use super::quiet::quietly;

/// Bytes of memory that a workgroup of our kernels shares at most.
pub const WORKGROUP_MEMORY: u32 = 25 << 10;
/// Invocations of a workgroup of our kernels.
pub const WORKGROUP_SIZE: u32 = 256;
/// Arrays that one of our kernels sees.
pub const BINDINGS: u32 = 8;

/// What [`Report::features`] calls kernels that can name numbers of 16 bits: it is the one feature
/// that they use.
pub const HALVES: &str = "16-bit floats in kernels";

/// What `doctor` says of one adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// The number that `gpu:N` names.
    pub index: usize,
    /// The adapter's name, as its driver gives it.
    pub name: String,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// The driver and its version.
    pub driver: String,
    /// Whether it is hardware, not a program on the CPU.
    pub hardware: bool,
    /// Named limits that the kernels depend on, and their values.
    pub limits: Vec<(&'static str, u64)>,
    /// Named features that kernels could use, and whether the adapter has them.
    pub features: Vec<(&'static str, bool)>,
    /// Why our kernels cannot run on it, if they cannot.
    pub unfit: Option<String>,
}

/// An adapter with what is known of it.
pub struct Found {
    /// wgpu's handle, from which a device is opened.
    pub adapter: wgpu::Adapter,
    /// Its name, driver, limits and fitness, as `doctor` prints them.
    pub report: Report,
}

/// Whether this may be a machine with a GPU of hardware, asked in no time: on Linux, its driver has
/// made a device file.
pub fn hardware_is_likely() -> bool {
    // NVIDIA's, that of Windows' Linux, and Mesa's.
    const FILES: [&str; 3] = ["/dev/nvidiactl", "/dev/dxg", "/dev/dri/renderD128"];
    !cfg!(target_os = "linux") || FILES.iter().any(|file| std::path::Path::new(file).exists())
}

/// The drivers of this machine, through Vulkan, Metal or DX12. Environment variables of wgpu
/// (`WGPU_VALIDATION=1`) count.
fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    wgpu::Instance::new(descriptor)
}

/// All adapters, hardware first, in an order that stays the same; or why there is none.
pub fn find() -> Result<Vec<Found>, GpuError> {
    let (instance, mut adapters) = quietly(|| {
        let instance = instance();
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        (instance, adapters)
    });
    if adapters.is_empty() {
        return Err(GpuError::NoAdapter(absence(&instance)));
    }
    // A stable sort: among equals the loader's order stays, and `gpu:1` names the same one.
    adapters.sort_by_key(|adapter| order(adapter.get_info().device_type));
    let found = |(index, adapter)| Found {
        report: report(index, &adapter),
        adapter,
    };
    Ok(adapters.into_iter().enumerate().map(found).collect())
}

/// Why no adapter was found: whether the loader of the drivers is missing, or drivers are.
fn absence(instance: &wgpu::Instance) -> String {
    // A list that is empty gives no reason, and this call's error gives it as text only.
    match pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())) {
        Err(error) if error.to_string().contains("vulkan drivers/libraries could not be loaded") => {
            "the Vulkan loader cannot be loaded; on Linux it is libvulkan.so.1, which Debian and Ubuntu have in libvulkan1".into()
        }
        Err(error) if error.to_string().contains("vulkan found no adapters") => {
            "the Vulkan loader finds no driver; install that of the GPU, on Debian and Ubuntu for most mesa-vulkan-drivers".into()
        }
        Err(error) => error.to_string(),
        Ok(_) => "no adapter is listed".into(),
    }
}

fn order(kind: wgpu::DeviceType) -> usize {
    use wgpu::DeviceType::{Cpu, DiscreteGpu, IntegratedGpu, Other, VirtualGpu};
    [DiscreteGpu, IntegratedGpu, VirtualGpu, Other, Cpu]
        .iter()
        .position(|&known| known == kind)
        .unwrap_or(usize::MAX)
}

fn report(index: usize, adapter: &wgpu::Adapter) -> Report {
    let info = adapter.get_info();
    let limits = adapter.limits();
    let features = adapter.features();
    let driver = format!("{} {}", info.driver, info.driver_info)
        .trim()
        .to_owned();
    Report {
        index,
        backend: info.backend.to_string(),
        hardware: info.device_type != wgpu::DeviceType::Cpu,
        limits: vec![
            (
                "bytes of one array that a kernel sees",
                limits.max_storage_buffer_binding_size,
            ),
            ("bytes of one array", limits.max_buffer_size),
            (
                "bytes that a workgroup shares",
                limits.max_compute_workgroup_storage_size.into(),
            ),
            (
                "invocations of a workgroup",
                limits.max_compute_invocations_per_workgroup.into(),
            ),
            (
                "arrays that a kernel sees",
                limits.max_storage_buffers_per_shader_stage.into(),
            ),
        ],
        features: vec![
            (HALVES, features.contains(wgpu::Features::SHADER_F16)),
            ("subgroups", features.contains(wgpu::Features::SUBGROUP)),
            (
                "cooperative matrices",
                features.contains(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX),
            ),
            (
                "timestamps",
                features.contains(wgpu::Features::TIMESTAMP_QUERY),
            ),
        ],
        unfit: lack(&limits),
        name: info.name,
        driver,
    }
}

/// What the kernels need and the adapter lacks.
fn lack(limits: &wgpu::Limits) -> Option<String> {
    let needs = [
        (
            "bytes that a workgroup shares",
            limits.max_compute_workgroup_storage_size,
            WORKGROUP_MEMORY,
        ),
        (
            "invocations of a workgroup",
            limits.max_compute_invocations_per_workgroup,
            WORKGROUP_SIZE,
        ),
        (
            "arrays that a kernel sees",
            limits.max_storage_buffers_per_shader_stage,
            BINDINGS,
        ),
    ];
    let missing = needs.into_iter().find(|(_, has, needed)| has < needed);
    missing.map(|(what, has, needed)| format!("{what}: {has} of the {needed} that are needed"))
}

/// The adapter numbered `index`, or, without a number, the first that is hardware.
pub fn choose(index: Option<usize>) -> Result<Found, GpuError> {
    let mut found = find()?;
    let count = found.len();
    let at = match index {
        Some(asked) if asked >= count => return Err(GpuError::NoSuchAdapter { asked, count }),
        Some(asked) => asked,
        // Software computes on the CPU, where our own kernels do.
        None if !found[0].report.hardware => {
            return Err(GpuError::OnlySoftware(found.swap_remove(0).report.name));
        }
        None => 0,
    };
    let chosen = found.swap_remove(at);
    match &chosen.report.unfit {
        Some(reason) => Err(GpuError::Unfit {
            adapter: chosen.report.name,
            reason: reason.clone(),
        }),
        None => Ok(chosen),
    }
}

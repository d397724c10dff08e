//! Where networks are trained: the processor, or a GPU where the program is built with the feature `gpu`.

use crate::error::TrackError;
use burn::tensor::Device;

/// Device by its name: `cpu`, `gpu` (the best there is), or `gpu:N` for the discrete GPU of that number.
///
/// # Errors
/// Where the name is another one, this build has no GPU in it, or no GPU can be used.
pub fn device(name: &str) -> Result<Device, TrackError> {
    let other = || TrackError::value("device", "cpu, gpu or gpu:N", name);
    match name.split_once(':') {
        None if name == "cpu" => Ok(Device::flex()),
        None if name == "gpu" => gpu(name, None),
        Some(("gpu", number)) => gpu(name, Some(number.parse().map_err(|_| other())?)),
        _ => Err(other()),
    }
}

#[cfg(feature = "gpu")]
fn gpu(name: &str, number: Option<usize>) -> Result<Device, TrackError> {
    use burn::tensor::{DeviceKind, Tensor};
    let kind = number.map_or(DeviceKind::DefaultDevice, DeviceKind::DiscreteGpu);
    // Without a driver the library panics at the first use.
    let tried = std::panic::catch_unwind(|| {
        let device = Device::wgpu(kind);
        let one: f32 = Tensor::<1>::ones([1], &device).into_scalar();
        (one == 1.0).then_some(device)
    });
    let found = tried.ok().flatten();
    found.ok_or_else(|| {
        TrackError::value(format!("device {name}"), "a GPU with a Vulkan, Metal or DX12 driver", "none")
    })
}

#[cfg(not(feature = "gpu"))]
fn gpu(name: &str, _number: Option<usize>) -> Result<Device, TrackError> {
    Err(TrackError::value(format!("device {name}"), "a program built with --features gpu", "one without"))
}

#[cfg(test)]
mod tests {
    use super::device;

    #[test]
    fn devices_that_are_not_there_are_named() {
        assert!(device("cpu").is_ok());
        for name in ["cuda", "gpu:x", "cpu:1"] {
            let error = device(name).unwrap_err().to_string();
            assert!(error.contains("gpu:N") && error.contains(name), "{error}");
        }
        #[cfg(not(feature = "gpu"))]
        assert!(device("gpu:1").unwrap_err().to_string().contains("--features gpu"));
    }
}

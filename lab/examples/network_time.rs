//! Time of a training step and of a streamed token of the network, for
//! `tests/peers/network_peers.py`.
//!
//! `network_time DIR STEPS TOKENS`: writes `net.safetensors`, and `case.safetensors` with inputs,
//! targets, bias, what comes out and the streamed answers, so that a peer can show that it is the
//! same network; prints times as JSON. RAYON_NUM_THREADS says on how many threads.
#![allow(missing_docs, reason = "an example")]

use burn::module::Module;
use burn::nn::loss::{MseLoss, Reduction};
use burn::optim::{AdamConfig, GradientsParams};
use burn::store::{ModuleSnapshot, SafetensorsStore};
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use std::path::{Path, PathBuf};
use std::time::Instant;
use wcal_lab::model_file::{paper, runnable};
use wcal_lab::network::TrainableNet;
use wcal_lab::network::attention_bias;
use wcal_network::network::{FeatureExtractor, KvCache, NetworkConfig, WhiskerNet};

/// As in `wcal-lab`: a step's tensors are given back and asked for again, page by page, by the
/// system's own allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Sweep series in a batch and tokens in a series: the peers' case.
const BATCH: usize = 64;
const TIME: usize = 100;
/// Nodes of the curve that the shipped networks' inputs are made of.
const NODES: usize = 130;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, folder, steps, tokens] = &args[..] else {
        return Err("network_time DIR STEPS TOKENS".into());
    };
    let (folder, steps, tokens) = (PathBuf::from(folder), steps.parse()?, tokens.parse()?);
    std::fs::create_dir_all(&folder)?;
    let device = Device::flex();
    device.seed(7);
    let config = NetworkConfig {
        dropout: 0.0,
        ..paper(FeatureExtractor::width(NODES, false))
    };
    let case = Case::new(&config, &device);
    let net = TrainableNet::new(&config, &device)?;
    let mut store = SafetensorsStore::from_file(folder.join("net.safetensors")).overwrite(true);
    net.save_into(&mut store)?;
    case.write(&folder, &net)?;
    // The paper's dropout is part of the step that is timed, not of the comparison.
    let with_dropout = NetworkConfig {
        dropout: 0.1,
        ..config
    };
    let (step_s, step_cpu_s, losses) = train(&with_dropout, &case, steps, &device)?;
    let (token_us, token_cpu_us) = stream(&runnable(&net, &config)?.0, &config, tokens);
    let document = serde_json::json!({
        "batch": BATCH, "time": TIME, "inputs": config.inputs, "parameters": net.num_params(),
        "step_s": step_s, "step_cpu_s": step_cpu_s, "losses": losses, "token_us": token_us, "token_cpu_us": token_cpu_us,
    });
    std::fs::write(folder.join("ours.json"), serde_json::to_string(&document)?)?;
    Ok(())
}

/// A batch.
struct Case {
    config: NetworkConfig,
    inputs: Tensor<3>,
    targets: Tensor<3>,
    times_s: Vec<Vec<f64>>,
}

impl Case {
    fn new(config: &NetworkConfig, device: &Device) -> Self {
        let times_s = vec![(0..TIME).map(|k| 0.1 * k as f64).collect(); BATCH];
        Self {
            config: *config,
            inputs: Tensor::random(
                [BATCH, TIME, config.inputs],
                Distribution::Normal(0.0, 1.0),
                device,
            ),
            targets: Tensor::random([BATCH, TIME, 3], Distribution::Normal(0.0, 1.0), device),
            times_s,
        }
    }

    fn bias(&self, device: &Device) -> Tensor<4> {
        attention_bias(
            &self.times_s,
            self.config.heads,
            self.config.context,
            device,
        )
    }

    /// What a peer compares itself with: raw little-endian single precision, one file a tensor.
    fn write(&self, folder: &Path, net: &TrainableNet) -> Result<(), Box<dyn std::error::Error>> {
        let device = self.inputs.device();
        let out = net.forward(self.inputs.clone(), self.bias(&device));
        let save = |name: &str, data: TensorData| -> Result<(), Box<dyn std::error::Error>> {
            let values: Vec<f32> = data.try_to_vec()?;
            let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
            Ok(std::fs::write(folder.join(name), bytes)?)
        };
        save("inputs.f32", self.inputs.clone().into_data())?;
        save("targets.f32", self.targets.clone().into_data())?;
        save("out.f32", out.into_data())
    }
}

/// Time of each step: forward, mean square of three numbers, backward, Adam.
#[allow(clippy::type_complexity, reason = "used once")]
fn train(
    config: &NetworkConfig,
    case: &Case,
    steps: usize,
    device: &Device,
) -> Result<(Vec<f64>, Vec<f64>, Vec<f32>), Box<dyn std::error::Error>> {
    let learning = device.clone().autodiff();
    let mut net = TrainableNet::new(config, &learning)?;
    let mut optimizer = AdamConfig::new().with_epsilon(1e-8).init();
    let (inputs, targets) = (
        case.inputs.clone().into_data(),
        case.targets.clone().into_data(),
    );
    let (mut wall, mut cpu, mut losses) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..steps {
        let (begin, begin_cpu_s) = (Instant::now(), cpu_s());
        let inputs = Tensor::<3>::from_data(inputs.clone(), &learning);
        let targets = Tensor::<3>::from_data(targets.clone(), &learning);
        let out = net.forward(inputs, case.bias(&learning)).narrow(2, 0, 3);
        let loss = MseLoss::new().forward(out, targets, Reduction::Mean);
        let gradients = GradientsParams::from_grads(loss.backward(), &net);
        net = optimizer.step(3e-4, net, gradients);
        losses.push(loss.into_scalar::<f32>());
        wall.push(begin.elapsed().as_secs_f64());
        cpu.push(cpu_s() - begin_cpu_s);
    }
    Ok((wall, cpu, losses))
}

/// Time of each streamed token with a full cache, and CPU time a token over all, us.
fn stream(net: &WhiskerNet, config: &NetworkConfig, tokens: usize) -> (Vec<f64>, f64) {
    let mut memory = KvCache::default();
    let values: Vec<f32> = (0..config.inputs)
        .map(|k| (k as f32 * 0.37).sin())
        .collect();
    let mut push = |k: usize| {
        std::hint::black_box(net.step(&values, 0.1 * k as f64, config.context, &mut memory));
    };
    (0..config.context).for_each(&mut push);
    let begin_cpu_s = cpu_s();
    let mut times_us = Vec::with_capacity(tokens);
    for k in 0..tokens {
        let begin = Instant::now();
        push(config.context + k);
        times_us.push(begin.elapsed().as_secs_f64() * 1e6);
    }
    (
        times_us,
        (cpu_s() - begin_cpu_s) * 1e6 / tokens.max(1) as f64,
    )
}

/// CPU time of this process, s (Linux, in steps of 10 ms).
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let fields: Vec<f64> = after_name
        .split_whitespace()
        .skip(11)
        .take(2)
        .flat_map(str::parse)
        .collect();
    fields.iter().sum::<f64>() / 100.0
}

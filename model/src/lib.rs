//! Definition, trainer and quantizer of the network.

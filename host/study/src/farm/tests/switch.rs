//! A cable with a plug: forwards a port, and can be pulled or plugged into another device.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;

use device::port::Address;
use plant::locked;

/// A forwarded port. Its threads end with their connections, the last one with the process.
pub struct Switch {
    address: Address,
    target: Arc<Mutex<String>>,
    open: Arc<Mutex<Vec<TcpStream>>>,
}

impl Switch {
    /// Forwards a free port to this address.
    pub fn start(target: &Address) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(listener.local_addr().unwrap().to_string());
        let (target, open) = (Arc::new(Mutex::new(tcp(target))), Arc::new(Mutex::new(Vec::new())));
        let (to, connections) = (Arc::clone(&target), Arc::clone(&open));
        thread::spawn(move || {
            for host in listener.incoming().flatten() {
                let Ok(device) = TcpStream::connect(&*locked(&to)) else { continue };
                for stream in [&host, &device] {
                    stream.set_nodelay(true).unwrap();
                    locked(&connections).push(stream.try_clone().unwrap());
                }
                forward(&host, &device);
                forward(&device, &host);
            }
        });
        Self { address, target, open }
    }

    /// The port for the host.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Pulls the plug: all connections break. The next one finds the device again.
    pub fn pull(&self) {
        for stream in locked(&self.open).drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Pulls the plug and leaves it out.
    pub fn unplug(&self) {
        locked(&self.target).clear();
        self.pull();
    }

    /// Plugs the cable into another device.
    pub fn connect_to(&self, target: &Address) {
        *locked(&self.target) = tcp(target);
        self.pull();
    }
}

fn tcp(address: &Address) -> String {
    match address {
        Address::Tcp(address) => address.clone(),
        Address::Serial { .. } => panic!("the devices of these tests are at TCP ports"),
    }
}

fn forward(from: &TcpStream, to: &TcpStream) {
    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if to.write_all(&bytes[..count]).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}

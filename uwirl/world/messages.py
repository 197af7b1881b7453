"""Acoustic messages: what vehicles send to each other, and the SNR at which sensors receive them (eqs 9-10)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import distances, length
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.scenario import Scenario
from uwirl.world.truth import Truth


class Messages(NamedTuple):
    """What each of M vehicles [B, M] has received in this step; index j of the third dimension is the sender.

    Vehicles send each other their poses at every step; with itself as the sender, a vehicle has its own pose.

    Attributes:
        eta: poses, [B, M, M, 4].
        nu: velocities, [B, M, M, 4].
        target: target that each sender has announced, [B, M, M, 3], m; nan if it has announced none.
        snr: SNR of the vehicle's own message, the source's and the destination's at each of the N sensors, as answered
            by these, [B, M, 3, N], dB, nan where nothing was received; [B, M, 3, 0] in a step without a message.
    """

    eta: Tensor
    nu: Tensor
    target: Tensor
    snr: Tensor


def told_to_all(values: Tensor) -> Tensor:
    """Values [..., M, k] of each sender as received by every vehicle, [..., M, M, k], a view."""
    spread = values.unsqueeze(-3)
    return spread if spread.shape[-2] == 1 else spread.expand(*values.shape[:-1], *values.shape[-2:])


def transmitters(scenario: Scenario, position: Tensor) -> Tensor:
    """Positions of the three senders of an exchange: vehicle [..., 3], source, destination; [..., 3, 3], float64, m."""
    nodes = [node.expand_as(position) for node in (scenario.source, scenario.destination)]
    return torch.stack([position, *nodes], -2).to(torch.float64)


def snr_heard(
    scenario: Scenario, truth: Truth, streams: RandomStreams, position: Tensor, vehicle: int, message: int | Tensor
) -> Tensor:
    """SNR at the sensors of one vehicle's message, and of the source's and the destination's.

    The vehicle sends a message. The sensors within hearing range (the set N_i) answer with its SNR and, if they are
    within hearing range of source and destination, with the SNR of messages from these. A reading is mean SNR (6)
    plus shadowing plus multipath; multipath is drawn independently for each reading.

    Args:
        scenario: sensors and hearing range.
        truth: the channel.
        streams: random numbers of B worlds.
        position: of the vehicle, [B, 3], m.
        vehicle: its number.
        message: number of the message, from 0; a number or int64 [B].

    Returns:
        [B, 3, N], dB; nan where a sensor received nothing or did not answer.
    """
    sent, sensors = transmitters(scenario, position), scenario.sensors.to(torch.float64)
    distance = distances(sent, sensors)
    ends = sent[..., None, :].expand(*distance.shape, 3), sensors.expand(*distance.shape, 3)
    shadowing = truth.shadowing(*(end.flatten(1, 2) for end in ends)).view_as(distance)
    draw = message * scenario.vehicles + vehicle
    multipath = streams.normal(Stream.MEASUREMENT, draw, distance[0].numel()).view_as(distance)
    snr = truth.channel.mean_snr_dB(distance) + shadowing + truth.channel.rho_dB * multipath
    heard = distance <= scenario.hearing_range
    return torch.where(heard & heard[:, :1], snr, torch.nan)


def link_snr_heard(
    scenario: Scenario, truth: Truth, streams: RandomStreams, position: Tensor, message: Tensor
) -> Tensor:
    """SNR at each vehicle of a message from each of its two neighbours in the chain.

    Mean SNR (6), plus shadowing, which is equal in both directions, plus multipath, drawn for each reading.

    Args:
        scenario: hearing range.
        truth: the channel.
        streams: random numbers of B worlds.
        position: of the vehicles in chain order, [B, M, 3], m.
        message: number of the message, from 0, int64 [B].

    Returns:
        SNR of the messages from the neighbours towards source and destination, [B, M, 2], dB, float64; nan where
        nothing was received.
    """
    position = position.double()
    link = truth.link_snr_dB(position, shadowed=True)
    if scenario.hearing_range < torch.inf:
        distance = length(truth.chain(position).diff(dim=-2))
        link = link.masked_fill(distance > scenario.hearing_range, torch.nan)
    multipath = streams.normal(Stream.LINKS, message, 2 * scenario.vehicles).view(-1, scenario.vehicles, 2)
    return torch.stack([link[:, :-1], link[:, 1:]], -1) + truth.channel.rho_dB * multipath

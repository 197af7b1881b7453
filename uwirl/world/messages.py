"""Acoustic messages: what vehicles tell each other, and how well sensors hear them (eqs 9-10)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import distances
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.scenario import Scenario
from uwirl.world.truth import Truth


class Messages(NamedTuple):
    """What each of M vehicles [B, M] has received in this step; entry j of the third dimension is from vehicle j.

    Vehicles tell each other their poses at every step; an entry about the vehicle itself is its own.

    Attributes:
        eta: poses, [B, M, M, 4].
        nu: velocities, [B, M, M, 4].
        target: where each means to go, [B, M, M, 3], m; nan of a vehicle that has not said.
        snr: readings of the vehicle's own message, of the source's and of the destination's by each of the N sensors
            that answered it, [B, M, 3, N], dB, nan where nothing was heard; [B, M, 3, 0] in a step without a message.
    """

    eta: Tensor
    nu: Tensor
    target: Tensor
    snr: Tensor


def told_to_all(values: Tensor) -> Tensor:
    """Values [..., M, k] of each vehicle as all of them receive these, [..., M, M, k], a view."""
    spread = values.unsqueeze(-3)
    return spread if spread.shape[-2] == 1 else spread.expand(*values.shape[:-1], *values.shape[-2:])


def transmitters(scenario: Scenario, position: Tensor) -> Tensor:
    """Where an exchange's messages are sent: vehicle [..., 3], source and destination; [..., 3, 3], float64, m."""
    nodes = [node.expand_as(position) for node in (scenario.source, scenario.destination)]
    return torch.stack([position, *nodes], -2).to(torch.float64)


def snr_heard(
    scenario: Scenario, truth: Truth, streams: RandomStreams, position: Tensor, vehicle: int, message: int | Tensor
) -> Tensor:
    """SNR that the sensors read of one vehicle's message, and of the source's and the destination's.

    The vehicle asks, and the sensors within hearing range answer (the set N_i) with what they read of it and, being
    nodes of the same network, of source and destination where they hear those. A reading is mean SNR (6) plus
    shadowing plus multipath, the latter drawn anew for each.

    Args:
        scenario: sensors and hearing range.
        truth: the channel.
        streams: random numbers of B worlds.
        position: of the vehicle, [B, 3], m.
        vehicle: its number.
        message: the number of its message, from 0; a number or int64 [B].

    Returns:
        [B, 3, N], dB; nan where nothing was heard or not answered.
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
    """SNR that each vehicle reads of a message from either neighbour in the chain.

    Mean SNR (6) plus shadowing, which is the same both ways, plus multipath, drawn anew for each reading.

    Args:
        scenario: hearing range.
        truth: the channel.
        streams: random numbers of B worlds.
        position: of the vehicles in chain order, [B, M, 3], m.
        message: its number, from 0, int64 [B].

    Returns:
        From the side of the source and from that of the destination, [B, M, 2], dB, float64; nan where nothing was
        heard.
    """
    position = position.double()
    link = truth.link_snr_dB(position, shadowed=True)
    if scenario.hearing_range < torch.inf:
        distance = torch.linalg.vector_norm(truth.chain(position).diff(dim=-2), dim=-1)
        link = link.masked_fill(distance > scenario.hearing_range, torch.nan)
    multipath = streams.normal(Stream.LINKS, message, 2 * scenario.vehicles).view(-1, scenario.vehicles, 2)
    return torch.stack([link[:, :-1], link[:, 1:]], -1) + truth.channel.rho_dB * multipath

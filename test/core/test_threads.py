# SPDX-License-Identifier: Apache-2.0
"""BLAS has one thread while a model is built, and as many as before afterwards."""

from threadpoolctl import threadpool_info, threadpool_limits

from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.scene import assembly


def blas_threads():
    return [found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"]


def test_a_model_is_built_with_one_blas_thread(monkeypatch):
    seen, assembled = [], assembly.assembled

    def watched(*arguments):
        seen.append(blas_threads())
        return assembled(*arguments)

    monkeypatch.setattr(assembly, "assembled", watched)
    with threadpool_limits(2, "blas"):
        before = blas_threads()
        Engine(load_scene("four_bar"), quiet=True)
        assert blas_threads() == before
    assert seen and all(set(threads) == {1} for threads in seen)

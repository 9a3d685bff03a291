"""FLS peg transfer: scene, referee, score, agents, perception and report, all in this folder."""

